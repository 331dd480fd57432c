r"""Numbers in the documentation that come from stored results: written and checked by command.

    python -m harness.report.claims check [FILE.md ...]
    python -m harness.report.claims write [FILE.md ...]

In a text, a number stands between two comments, of which the first names its cell in a table of the
report of a published suite::

    <!-- claim table2: table2 | uniform-sphere | geometric mean | two-lobe -->2.09<!-- /claim -->

the results folder (in ``results/reference``), then table, section (empty where the table has one
without a title), row and column. ``| interval`` behind them adds the interval. A block of them, a
row for each column of the report's tables (the methods) and a column for each pair of table and
section (and row, where it is another), is::

    <!-- claims table2: geometric mean | equal time = table2, uniform-sphere | ... -->
    <!-- /claims -->

``write`` puts in what is stored, ``check`` says what differs. A number of which a trial was
measured with code that has changed since is followed by "(stale)": a text cannot keep quiet.
Below a block of which all are stale one sentence says so.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from pathlib import Path

from harness.analysis.results import Results
from harness.core.paths import ROOT
from harness.core.protocol.errors import InputError, nearest
from harness.report.parts import part, parts
from harness.report.table import Cell, Table
from harness.store.database import file_of, folders_in
from harness.store.frame import STALE

REFERENCE = ROOT / "results" / "reference"
FILES = ("README.md", "docs/*.md")
NONE = "–"
"""In a table, where there is no number."""
_FEW = re.compile(r"mean over (\d+ of \d+) materials only")
_STALE = " (stale)"
_ALL_STALE = (
    "All of these are stale: measured with code that has changed since, as\n"
    "`harness status results/reference/{folder}` says in detail."
)
_INLINE = re.compile(r"(<!-- claim ([^>]*?) -->)(.*?)(<!-- /claim -->)", re.DOTALL)
_BLOCK = re.compile(r"(<!-- claims ([^>]*?) -->\n)(.*?)(<!-- /claims -->)", re.DOTALL)


class Source:
    """The tables of one results folder, each made once."""

    def __init__(self, folder: Path):
        if file_of(folder) is None:
            known = [found.name for found in folders_in(folder.parent)]
            raise InputError(f"no such results: {folder.name}{nearest(folder.name, known)}")
        self.results = Results.load(folder)
        self._tables: dict[str, Table] = {}
        frame = self.results.frame
        # A fit's seconds are no part of what is measured with it.
        self._stale = frame[(frame["status"] == STALE) & (frame["measure"] != "fit")]

    def table(self, name: str) -> Table:
        """The table of that name, as in the report."""
        if name not in self._tables:
            known = parts("tables")
            if name not in known:
                raise InputError(f"no such table: {name}{nearest(name, known)}")
            made = part("tables", name)(self.results)
            if isinstance(made, str):
                raise InputError(f"table {name}: {made}")
            self._tables[name] = made
        return self._tables[name]

    def cell(self, table: str, section: str, row: str, column: str) -> Cell:
        """One cell; what is not there is refused with the nearest name.

        It may have no number: see :attr:`Cell.missing`.
        """
        found = self.table(table)
        sections = {s.title: s for s in found.sections}
        rows = {r.label: r for r in _one(section, sections, "section").rows}
        columns = {name: i for i, name in enumerate(found.columns)}
        place = _one(column, columns, "column")
        return _one(row, rows, "row").cells[place]

    def stale(self, section: str, row: str, column: str) -> bool:
        """Whether a trial of the cell's method, material and scene does not hold any more."""
        old = self._stale
        for key, names in (
            ("method", {m.label for m in self.results.methods}),
            ("material", set(self.results.materials)),
            ("scene", set(self.results.frame["scene"]) - {""}),
        ):
            named = names & {section, row, column}
            if named:
                old = old[old[key].isin(named | {""})]
        return bool(len(old))

    def said(self, words: list[str], interval: bool, escaped: bool = False) -> str:
        """A cell as text: number, interval, and whether it is stale.

        ``escaped``, for a table in Markdown, has the mark of a number with a note, too, or of how
        many materials a mean is; and a dash where there is no number. Elsewhere that is refused.
        """
        cell = self.cell(*words)
        if cell.missing and escaped:
            return NONE
        if cell.missing:
            raise InputError(f"{' | '.join(words)}: {cell.missing}")
        number, within = cell.parts
        old = self.stale(*words[1:])
        if escaped and cell.warning and not old:
            few = _FEW.match(cell.warning)
            number += f" ({few[1]})" if few else " ‡"
        if interval and within:
            number += " " + (within.replace("[", r"\[").replace("]", r"\]") if escaped else within)
        return number + (_STALE if old else "")


@lru_cache(maxsize=8)
def source(folder: Path) -> Source:
    """Of a results folder; read once."""
    return Source(folder)


def renewed(text: str, reference: Path = REFERENCE) -> str:
    """``text`` with every claim as it is stored.

    Raises:
        InputError: a claim names something that is not there.
    """
    text = _BLOCK.sub(lambda m: m[1] + _block(m[2], reference) + m[4], text)
    return _INLINE.sub(lambda m: m[1] + _inline(m[2], reference) + m[4], text)


def differences(text: str, reference: Path = REFERENCE) -> list[str]:
    """What is not as it is stored, a line each; claims that name nothing are among them."""
    found = []
    for pattern, say in ((_BLOCK, _block), (_INLINE, _inline)):
        for match in pattern.finditer(text):
            line = text.count("\n", 0, match.start()) + 1
            try:
                stored = say(match[2], reference)
            except InputError as error:
                found.append(f"{line}: {error}")
                continue
            if match[3] != stored:
                found.append(f"{line}: says {match[3]!r}, stored is {stored!r}")
    return found


def _inline(claim: str, reference: Path) -> str:
    folder, words = _parsed(claim)
    interval = words[-1] == "interval"
    words = words[: len(words) - interval]
    if len(words) != 4:
        raise InputError(f"claim {claim!r}: expected table | section | row | column")
    return source(reference / folder).said(words, interval).replace("×", "")


def _block(claim: str, reference: Path) -> str:
    folder, (row, *columns) = _parsed(claim)
    found = source(reference / folder)
    titles, places = [], []
    for column in columns:
        title, _, place = column.partition("=")
        words = [word.strip() for word in place.split(",")]
        if len(words) not in (2, 3):
            raise InputError(
                f"claims {claim!r}: expected 'title = table, section' or, with a row of its own,"
                f" 'title = table, section, row', got {column!r}"
            )
        titles.append(title.strip())
        places.append((*words, row)[:3])
    if not places:
        raise InputError(f"claims {claim!r}: expected row | title = table, section | ...")
    methods = list(dict.fromkeys(m for table, *_ in places for m in found.table(table).columns))
    lines = [f"| method | {' | '.join(titles)} |", f"| :--- |{' ---: |' * len(titles)}"]
    rows = {
        method: [
            found.said([table, section, at, method], True, escaped=True)
            if method in found.table(table).columns
            else NONE
            for table, section, at in places
        ]
        for method in methods
    }
    rows = {method: cells for method, cells in rows.items() if set(cells) != {NONE}}
    numbers = [cell for cells in rows.values() for cell in cells if cell != NONE]
    if old := all(cell.endswith(_STALE) for cell in numbers):
        rows = {method: [c.removesuffix(_STALE) for c in cells] for method, cells in rows.items()}
    lines += [f"| `{method}` | {' | '.join(cells)} |" for method, cells in rows.items()]
    if old:
        lines += ["", _ALL_STALE.format(folder=folder)]
    return "\n".join(lines) + "\n"


def _parsed(claim: str) -> tuple[str, list[str]]:
    folder, colon, rest = claim.partition(":")
    if not colon:
        raise InputError(f"claim {claim!r}: expected 'folder: ...'")
    return folder.strip(), [word.strip() for word in rest.split("|")]


def _one(name: str, among: dict, what: str):
    if name not in among:
        raise InputError(f"no such {what}: '{name}'{nearest(name, among)}")
    return among[name]


def documents(names: Iterable[str] = ()) -> list[Path]:
    """The files named, or all of the documentation."""
    if names := list(names):
        return [Path(name) for name in names]
    return [path for pattern in FILES for path in sorted(ROOT.glob(pattern))]


def main(arguments: list[str], say: Callable[[str], None] = print) -> int:
    """The command; its exit status: 1 if ``check`` found a difference, 2 if it was refused."""
    verb, *names = arguments or [""]
    if verb not in ("check", "write"):
        say(f"expected 'check' or 'write', got {verb!r}")
        return 2
    wrong = 0
    for path in documents(names):
        try:
            text = path.read_text(encoding="utf-8")
            if verb == "write":
                path.write_text(renewed(text), encoding="utf-8")
                continue
            found = differences(text)
        except (InputError, OSError) as error:
            say(f"{path}: {error}")
            return 2
        for line in found:
            say(f"{path}:{line}")
        wrong += len(found)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
