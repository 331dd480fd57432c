"""The table and the heat map of the suite ``stability``."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from rich.console import Console

from harness.analysis import verdicts
from harness.analysis.results import Results
from harness.analysis.verdicts import case_rows
from harness.core.record import Record
from harness.measures.base import Outcome
from harness.report import write as reports
from harness.report.figures.canvas import Canvas
from harness.report.figures.heatmap import _FACE
from harness.report.formats.csv import csv as as_csv
from harness.report.formats.latex import latex
from harness.report.formats.markdown import markdown
from harness.report.page.cells import plain_table
from harness.report.page.names import Names
from harness.report.parts import part
from harness.report.table import Cell, Table
from tests import report_results
from tests.report_results import Made

# --- the report ----------------------------------------------------------------------------------

PLACES = {"normal": 0, "grazing": 1, "specular": 2, "constant": 3, "untrained": 4}
GROUPS = {"specular": "lobe", "constant": "lobe", "untrained": "state"}
METHODS = ["cosine", "histogram", "native", "tabulated"]
Cases = dict[str, tuple[str, list[dict[str, Any]]]]


def said(prop: str, verdict: str, number: float | None = None, **worst: str) -> dict[str, Any]:
    return {
        "property": prop,
        "case": "",
        "verdict": verdict,
        "text": f"{prop} of it",
        "worst": worst,
        "number": number,
        "unit": "",
    }


class Folder(Made):
    """A results folder whose stability trials hold ``findings[(material, method, seed)]``."""

    findings: dict[tuple[str, str, int], Cases]

    def _outcome(self, measure, material, method, seed, hashed) -> Outcome:
        outcome = super()._outcome(measure, material, method, seed, hashed)
        if measure == "stability" and outcome.status == "ok":
            cases = [
                {
                    "case": name,
                    "group": GROUPS.get(name, "direction"),
                    "about": f"what <{name}> is",
                    "position": PLACES[name],
                    "verdict": verdict,
                    "findings": behind,
                }
                for name, (verdict, behind) in self.findings[material, method, seed].items()
            ]
            outcome.documents = {"findings": {"case_alarm": 1e-6, "cases": cases}}
        return outcome

    def _stability(self, random, chi2, variance, seconds, material, method) -> Outcome:
        return Outcome(records=[Record("normal", 0.0, unit="verdict")])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Every kind of verdict: two seeds of suede, a lobe, a fit that broke down."""
    fine: Cases = {"untrained": ("pass", []), "normal": ("pass", []), "grazing": ("pass", [])}
    bad = said("samples-pdf", "fail", wo="(0.6, 0.8)", got="nan")
    findings: dict[tuple[str, str, int], Cases] = {
        ("suede", method, seed): dict(fine) for method in METHODS for seed in (0, 1)
    }
    findings["suede", "cosine", 1]["grazing"] = (
        "degraded",
        [said("integral", "pass"), said("weights", "degraded", 0.0031)],
    )
    findings["suede", "histogram", 0]["untrained"] = ("fail", [bad, said("weights", "degraded", 0)])
    findings["suede", "tabulated", 0]["untrained"] = ("skip", [said("state", "skip")])
    for seed in (0, 1):
        findings["specular", "cosine", seed] = {
            "specular": ("degraded", [said("weights", "degraded", 2.2e-7)])
        }
        findings["specular", "tabulated", seed] = {
            "specular": ("degraded", [said("tail-index", "degraded", 1.25)])
        }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report_results, "SCENELESS", (*report_results.SCENELESS, "stability"))
        made = Folder(
            materials=["suede", "specular", "constant"],
            methods=METHODS,
            measures=("fit", "stability"),
            seeds=(0, 1),
            fail={
                (None, "native", "specular"): ("unsupported", "no sampler of its own"),
                ("fit", "histogram", "specular"): ("error", "it burned"),
                ("stability", "histogram", "specular"): ("skipped", "the fit ended as error"),
                (None, None, "constant"): ("unsupported", "not today"),
            },
        )
        made.findings = findings
        yield made.write(tmp_path_factory.mktemp("stability"))


def the_table(folder: Path) -> Table:
    table = part("tables", "stability")(Results.load(folder))
    assert isinstance(table, Table)
    return table


def cells(table: Table) -> dict[tuple[str, str], Cell]:
    return {
        (row.label, column): cell
        for section in table.sections[1:]
        for row in section.rows
        for column, cell in zip(table.columns, row.cells, strict=True)
    }


def test_rows_are_cases_in_the_order_and_groups_of_the_catalogue(folder: Path):
    table = the_table(folder)
    assert table.columns == METHODS
    layout = [(s.title, [row.label for row in s.rows]) for s in table.sections]
    assert layout == [
        ("all cases", ["pass", "degraded", "FAIL", "no answer"]),
        ("direction", ["normal", "grazing"]),
        ("lobe", ["specular"]),
        ("state", ["untrained"]),
        # No method has a trial, so that the material's cases are not known.
        ("cases unknown", ["constant"]),
    ]


def test_a_refused_state_has_its_share_in_the_cell():
    entry = verdicts._entry(
        {"verdict": "degraded", "findings": [said("state", "degraded", 0.0012)]}
    )
    assert (entry.verdict, entry.short) == ("degraded", "refused 0.12 %")


def test_cells_tell_pass_degraded_fail_and_no_answer(folder: Path):
    found = cells(the_table(folder))
    assert found["normal", "cosine"].text == "pass" and not found["normal", "cosine"].warning
    # The worst of two seeds.
    assert found["grazing", "cosine"].text == "eff 0.31 %"
    assert found["grazing", "cosine"].warning == "grazing, cosine: weights: weights of it"
    assert found["specular", "cosine"].text == "eff 2.2e−7"
    assert found["specular", "tabulated"].text == "tail 1.25"
    failed = found["untrained", "histogram"]
    assert (failed.text, failed.value, failed.shade) == ("FAIL", 2.0, "fail")
    assert failed.warning.endswith("samples-pdf of it; worst input: got nan, wo (0.6, 0.8)")
    assert found["specular", "native"].missing == "unsupported: no sampler of its own"
    assert found["constant", "cosine"].missing == "unsupported: not today"
    # One of two seeds had an answer.
    assert found["untrained", "tabulated"].text == "pass"


def test_a_fit_that_breaks_down_is_a_failure_not_a_dagger(folder: Path):
    failed = cells(the_table(folder))["specular", "histogram"]
    assert (failed.text, failed.missing) == ("FAIL", "")
    assert failed.warning == "specular, histogram: fit error: it burned"


def test_the_summary_counts_every_cell_once(folder: Path):
    table = the_table(folder)
    counts = np.array([[cell.value for cell in row.cells] for row in table.sections[0].rows])
    assert counts.sum(0).tolist() == [5.0] * len(METHODS)
    assert counts.tolist() == [[2, 2, 3, 3], [2, 0, 0, 1], [0, 2, 0, 0], [1, 1, 2, 1]]


def test_every_format_tells_them_apart(folder: Path):
    table = the_table(folder)
    page = plain_table(table, Names(Results.load(folder)))
    cells = [cell for part in page["sections"] for row in part["rows"] for cell in row["cells"]]
    for shade, count in (("pass", 10), ("degraded", 3), ("fail", 2)):
        summary = sum(bool(c.shade == shade) for r in table.sections[0].rows for c in r.cells)
        assert sum(cell.get("shade") == shade for cell in cells) == count + summary
    rows = {row["label"]: row for part in page["sections"] for row in part["rows"]}
    assert rows["grazing"]["about"] == "what <grazing> is"
    # A case opens the trial of its material and method.
    assert all(cell["k"] for cell in rows["grazing"]["cells"] if "t" in cell)
    assert "FAIL ‡" in markdown(table)
    assert r"FAIL$^{\ddagger" in latex(table) and "†" not in latex(table)
    rows = list(csv.DictReader(io.StringIO(as_csv(table))))
    by_place = {(row["row"], row["column"]): row for row in rows}
    assert by_place["specular", "cosine"]["value"] == "1.0"
    assert by_place["specular", "native"]["value"] == "nan"
    # Twenty-eight cases are stored, at a level of 1e-6 each.
    assert "at most 2.8e−5" in table.caption


def test_the_console_prints_reasons(folder: Path):
    out = io.StringIO()
    reports.load(folder).print(Console(file=out, width=120))
    text = out.getvalue()
    assert "eff 0.31 %" in text and "samples-pdf of it" in text and "fit error: it burned" in text


def test_the_figure_has_a_cell_for_each_with_the_colour_of_its_verdict(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    kept: list[Figure] = []
    save = Canvas.save
    monkeypatch.setattr(Canvas, "save", lambda s, f, *a: kept.append(f) or save(s, f, *a))
    results = Results.load(folder)
    (drawn,) = part("figures", "heatmap")(results, Canvas(tmp_path))
    assert {path.suffix for path in drawn.files} == {".png", ".pdf"}
    axes = kept[0].axes[0]
    patches = [p for p in axes.patches if isinstance(p, Rectangle)]
    plain = [p for p in patches if not p.get_hatch()]
    rows = case_rows(results)
    for verdict, face in _FACE.items():
        wanted = sum(entry.verdict == verdict for row in rows for entry in row.entries)
        assert sum(to_hex(p.get_facecolor()) == face for p in plain) == wanted
    words = [text.get_text() for text in axes.texts]
    assert words.count("FAIL") == 2 and "eff 0.31 %" in words and "lobe" in words
    hatched = [p for p in patches if p.get_hatch()]
    assert len(hatched) == sum(e.verdict == "skip" for row in rows for e in row.entries)


def test_words_of_the_figure_stay_in_their_places(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    kept: list[Figure] = []
    save = Canvas.save
    monkeypatch.setattr(Canvas, "save", lambda s, f, *a: kept.append(f) or save(s, f, *a))
    part("figures", "heatmap")(Results.load(folder), Canvas(tmp_path))
    (figure,) = kept
    extent = figure.bbox
    texts = [t for t in figure.axes[0].texts if t.get_text()]
    boxes = [t.get_window_extent() for t in texts] + [figure.legends[0].get_window_extent()]
    for box in boxes:
        assert extent.x0 <= box.x0 and box.x1 <= extent.x1
        assert extent.y0 <= box.y0 and box.y1 <= extent.y1
    overlaps = [
        (texts[i].get_text(), texts[j].get_text())
        for i in range(len(texts))
        for j in range(i)
        if boxes[i].overlaps(boxes[j])
    ]
    assert overlaps == []


def test_a_folder_without_the_measure_says_so(tmp_path: Path):
    results = Results.load(Made(materials=["suede"], measures=("fit",)).write(tmp_path))
    for said in (
        part("tables", "stability")(results),
        part("figures", "heatmap")(results, Canvas(tmp_path)),
    ):
        assert "no trial of the measure stability" in said
