"""A results folder's report: written, and printed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from harness.analysis.results import NO_TRIAL, Results
from harness.core.protocol.errors import InputError, nearest
from harness.report.formats.console import print_table
from harness.report.formats.csv import csv
from harness.report.formats.latex import latex
from harness.report.formats.markdown import markdown
from harness.report.parts import parts
from harness.report.place import forget_old, writing_to
from harness.report.table import Table
from harness.report.unplanned import planned_only

if TYPE_CHECKING:
    from harness.report.figures.canvas import Drawn

_FORMATS = {"md": markdown, "csv": csv, "tex": latex}


@dataclass(frozen=True)
class Report:
    """A results folder's report: its tables, and why others are left out, made once."""

    results: Results
    tables: list[Table]
    skipped: list[str]

    @classmethod
    def of(cls, results: Results) -> Report:
        """The tables that the results' suite asks for."""
        return cls(results, *_tables(results))

    def of_part(self, allowed: Mapping[str, Collection[str]]) -> Report:
        """The report of a part of the results: labels allowed by column, others as they are."""
        if not allowed:
            return self
        # What the part does not have was not asked for, and is not said to be left out.
        return replace(Report.of(self.results.restricted(allowed)), skipped=[])

    def write(self, notify: Callable[[str], None] = lambda message: None) -> list[Path]:
        """All of ``report/``, the page first, and figures too.

        Files of an earlier report that are no longer made are removed. ``notify`` is told what is
        left out and why.
        """
        report = self.results.folder / "report"
        with writing_to(report):
            return self._written(report, notify)

    def _written(self, report: Path, notify: Callable[[str], None]) -> list[Path]:
        # Figures take matplotlib, which printing tables does not.
        from harness.core.workers import together
        from harness.report import drawing
        from harness.report.page.build import PARTS, Page, page

        skipped = list(self.skipped)
        written = []
        for table in self.tables:
            for end, form in _FORMATS.items():
                written.append(report / f"{table.name}.{end}")
                written[-1].write_text(form(table), encoding="utf-8")
        names = _names(self.results, "figures", parts("figures"))
        pages = {f"page: {name}": partial(make, self.results) for name, make in PARTS.items()}
        figures = drawing.tasks(self.results, names, report / "figures")
        # The images of the page take longest.
        made = together(pages | figures, notify)
        drawn: list[Drawn] = []
        for name, found in drawing.collected(made, names).items():
            if not isinstance(found, str):
                drawn += found
            elif self.results.wanted("figures") is not None:
                skipped.append(f"figure {name}: {found}")
        written += [path for figure in drawn for path in figure.files]
        index = report / "index.html"
        content = Page(self.results, self.tables, drawn, skipped)
        prepared = {name: made[f"page: {name}"] for name in PARTS}
        index.write_text(page(content, prepared), encoding="utf-8")
        written.insert(0, index)
        for message in skipped:
            notify(f"left out: {message}")
        forget_old(report, written)
        return written

    def print(self, console: Console) -> None:
        """The tables, fitted to the width of ``console``, and whatever failed."""
        said: set[str] = set()
        for table in self.tables:
            print_table(table, console, said)
        for message in self.skipped:
            console.print(f"left out: {message}", style="dim", markup=False)


def _tables(results: Results) -> tuple[list[Table], list[str]]:
    """The tables wanted, and why others are left out. The status is always there."""
    tables, skipped = [], []
    known = parts("tables")
    names = _names(results, "tables", known)
    for name in [*(n for n in names if n != "status"), "status"]:
        table = known[name].load()(results)
        asked = results.wanted("tables") is not None
        if not isinstance(table, str):
            if asked or not _of_nothing_planned(table):
                tables.append(planned_only(table))
        elif asked:
            skipped.append(f"table {name}: {table}")
    return tables, skipped


def _of_nothing_planned(table: Table) -> bool:
    """Whether all that it could say is that the suite has no such trial."""
    cells = [cell for section in table.sections for row in section.rows for cell in row.cells]
    return bool(cells) and all(NO_TRIAL in cell.missing for cell in cells)


def _names(results: Results, kind: str, known: dict) -> list[str]:
    """Names the suite asks for; all known ones if it does not say."""
    wanted = results.wanted(kind)
    for name in wanted or ():
        if name not in known:
            raise InputError(f"report.{kind}: no such one: '{name}'{nearest(name, known)}")
    return list(known) if wanted is None else wanted


def load(results_dir: str | Path) -> Report:
    """The report of a results folder, to be written or printed."""
    return Report.of(Results.load(results_dir))
