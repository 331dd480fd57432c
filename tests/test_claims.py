"""Numbers in the documentation: as stored, or the test fails."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from harness.analysis.results import Results
from harness.core.protocol.errors import InputError
from harness.report import claims
from harness.report.parts import part
from tests.report_results import Made


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results with one suite, ``made``."""
    folder = tmp_path_factory.mktemp("reference")
    Made(scenes=("studio-sphere", "patch"), measures=("equal-spp", "equal-time")).write(
        folder / "made"
    )
    claims.source.cache_clear()
    return folder


CELL = "made: table2 | patch | geometric mean | cosine"
BLOCK = "made: geometric mean | time = table2, patch | samples = equal-spp, patch"


def text(inside: str = "", block: str = "", claim: str = CELL) -> str:
    """A document with a number and a table."""
    return (
        f"It is <!-- claim {claim} -->{inside}<!-- /claim --> times.\n\n"
        f"<!-- claims {BLOCK} -->\n{block}<!-- /claims -->\n"
    )


def test_documentation_is_as_stored():
    """All of it. ``python -m harness.report.claims write`` puts it right."""
    wrong = [
        f"{path.name}:{line}"
        for path in claims.documents()
        for line in claims.differences(path.read_text("utf-8"))
    ]
    assert wrong == []


def test_numbers_are_those_of_the_tables(reference: Path):
    """Written once, nothing differs; the rest of the text stays; the interval on request."""
    written = claims.renewed(text(), reference)
    assert claims.differences(written, reference) == []
    assert claims.renewed(written, reference) == written
    assert written.startswith(f"It is <!-- claim {CELL} -->")
    assert f"<!-- claims {BLOCK} -->\n| method | time | samples |\n" in written
    assert "<!-- /claim --> times.\n\n" in written
    assert written.endswith(" |\n<!-- /claims -->\n")
    results = Results.load(reference / "made")
    table = part("tables", "table2")(results)
    section = next(s for s in table.sections if s.title == "patch")
    cell = section.rows[-1].cells[table.columns.index("cosine")]
    number, interval = cell.parts
    assert f"-->{number.replace('×', '')}" in written
    whole = claims.renewed(text(claim=f"{CELL} | interval"), reference)
    assert f"-->{number.replace('×', '')} {interval}" in whole
    rows = [line for line in written.splitlines() if line.startswith("| `")]
    assert len(rows) == len(results.methods)


def test_means_of_few_materials_and_what_has_no_number(reference: Path, monkeypatch):
    """How many materials stands beside a mean; a dash for no number; no row without any."""
    made = claims.source(reference / "made")
    known = type(made).cell
    few = "mean over 2 of 3 materials only; without wool (not resolved)"

    def cell(self, table: str, section: str, row: str, column: str):
        found = known(self, table, section, row, column)
        if column == "cosine":
            return replace(found, warning=few)
        missing = column == "two-lobe" or (column, table) == ("improved-baseline", "equal-spp")
        return replace(found, missing="not resolved") if missing else found

    monkeypatch.setattr(type(made), "cell", cell)
    rows = claims.renewed(text(), reference).splitlines()
    (cosine,) = (line for line in rows if line.startswith("| `cosine`"))
    assert cosine.count(" (2 of 3)") == 2 and "‡" not in cosine
    assert not any("two-lobe" in line for line in rows if line.startswith("| `"))
    (baseline,) = (line for line in rows if line.startswith("| `improved-baseline`"))
    assert baseline.endswith("| – |")
    with pytest.raises(InputError, match="two-lobe: not resolved"):
        claims.renewed(text(claim=CELL.replace("cosine", "two-lobe")), reference)


def test_a_number_that_differs_is_found(reference: Path):
    """With its line; a single digit is enough."""
    written = claims.renewed(text(), reference)
    other = re.sub(r"(claim [^>]*-->)(\d)", lambda m: m[1] + str((int(m[2]) + 1) % 10), written)
    (found,) = claims.differences(other, reference)
    assert found.startswith("1: says '") and "stored is" in found
    (found,) = claims.differences(written.replace("| `cosine` |", "| `cosine`  |"), reference)
    assert found.startswith("3: says")


def test_a_stale_number_says_so(reference: Path, monkeypatch: pytest.MonkeyPatch):
    """When the code of one of its trials has changed, and only there."""
    fresh = claims.renewed(text(), reference)
    assert "(stale)" not in fresh
    made = claims.source(reference / "made")
    frame = made.results.frame
    old = frame[(frame["method"] == "cosine") & (frame["scene"] == "patch")].assign(status="stale")
    monkeypatch.setattr(made, "_stale", old)
    found = claims.differences(fresh, reference)
    assert len(found) == 2 and all("(stale)" in line for line in found)
    written = claims.renewed(text(), reference)
    assert written.count("(stale)") == 3
    assert all("cosine" in line for line in written.splitlines() if "(stale)" in line)
    monkeypatch.setattr(made, "_stale", frame.assign(status="stale"))
    written = claims.renewed(text(), reference)
    assert "All of these are stale" in written and "results/reference/made" in written
    assert not any("(stale)" in line for line in written.splitlines() if line.startswith("| `"))


@pytest.mark.parametrize(
    ("claim", "said"),
    [
        ("maid: table2 | patch | geometric mean | cosine", "did you mean 'made'?"),
        ("made: table3 | patch | geometric mean | cosine", "no such table: table3"),
        ("made: table2 | path | geometric mean | cosine", "did you mean 'patch'?"),
        ("made: table2 | patch | leather mean | cosine", "no such row"),
        ("made: table2 | patch | geometric mean | cosin", "did you mean 'cosine'?"),
        ("made: table2 | patch | cosine", "expected table | section | row | column"),
        ("made table2", "expected 'folder: ...'"),
    ],
)
def test_claims_that_name_nothing(reference: Path, claim: str, said: str):
    """Are found by a check, with the nearest name, and refused by a write."""
    found = claims.differences(text(claim=claim), reference)
    assert said in found[-1]
    with pytest.raises(InputError, match=re.escape(said)):
        claims.renewed(text(claim=claim), reference)


def test_command(tmp_path: Path, reference: Path, monkeypatch: pytest.MonkeyPatch):
    """0 if all is as stored, 1 if not, 2 if it was refused."""
    monkeypatch.setattr(claims, "REFERENCE", reference)
    monkeypatch.setattr(claims.differences, "__defaults__", (reference,))
    monkeypatch.setattr(claims.renewed, "__defaults__", (reference,))
    file, said = tmp_path / "a.md", []
    file.write_text(text("3"), "utf-8")
    assert claims.main(["check", str(file)], said.append) == 1 and len(said) == 2
    assert claims.main(["write", str(file)], said.append) == 0
    assert claims.main(["check", str(file)], said.append) == 0
    assert claims.main(["chek"], said.append) == 2
    assert claims.main(["write", str(tmp_path / "none.md")], said.append) == 2
