"""The report: from stored results to tables, figures and the page, failures included."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
import subprocess
import sys
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from harness.analysis import numbers
from harness.analysis.bias import corrected_p
from harness.analysis.combine import Estimate, arithmetic_mean, geometric_mean, over_seeds, ratio
from harness.analysis.quantities import nanoseconds_per_sample
from harness.analysis.results import MethodColumn, Results
from harness.core.protocol.errors import InputError
from harness.report import write as reports
from harness.report.figures.canvas import Canvas, grid_shape, styled
from harness.report.figures.images import _worst_square
from harness.report.figures.palette import looks
from harness.report.figures.rendered import exposure, reference, srgb
from harness.report.figures.tradeoff import Point, _front
from harness.report.formats.console import print_table
from harness.report.formats.csv import csv as as_csv
from harness.report.formats.html import html
from harness.report.formats.latex import escape as latex_escape
from harness.report.formats.latex import latex
from harness.report.formats.markdown import markdown
from harness.report.parts import part, parts
from harness.report.table import Cell, Footnotes, Row, Section, Table, embolden
from tests.report_results import MATERIALS, METHODS, Made

WEIRD = r"a_b & 50% #1 {x}~^\y|<i>$*`[z]"


@pytest.fixture(scope="module")
def failing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three materials, six methods; an error, an unsupported method, a biased one."""
    return Made(
        methods=[*list(METHODS)[:4], "tabulated", "neural-spline-flow"],
        fail={
            ("equal-time", "blinn-phong", "veined-marble"): ("error", "it_broke & burned: 50%"),
            (None, "neural-spline-flow", "quilted-satin"): ("unsupported", "too | shiny"),
        },
        bias={("fan-baseline", "elephant-hide"): 1e-12},
    ).write(tmp_path_factory.mktemp("failing"))


def printed(folder: Path, width: int = 120) -> str:
    out = io.StringIO()
    reports.load(folder).print(Console(file=out, width=width, force_terminal=False))
    return out.getvalue()


def table_of(folder: Path, name: str) -> Table:
    table = part("tables", name)(Results.load(folder))
    assert isinstance(table, Table), table
    return table


def cell_of(table: Table, row: str, column: str, section: int = 0) -> Cell:
    rows = {r.label: r for r in table.sections[section].rows}
    return rows[row].cells[table.columns.index(column)]


# --- numbers -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "low", "high", "expected"),
    [
        (1.87, 1.72, 2.02, ("1.87", "[1.72, 2.02]")),
        (0.15294, 0.146, 0.160, ("0.153", "[0.146, 0.160]")),
        (2.361, 1.9, 2.8, ("2.4", "[1.9, 2.8]")),
        (123456.0, 121000.0, 126000.0, ("1.23e5", "[1.21e5, 1.26e5]")),
        (1234.4, 1200.0, 1260.0, ("1230", "[1200, 1260]")),
        (0.00002, 0.000015, 0.00003, ("2.0e−5", "[1.5e−5, 3.0e−5]")),
        (-0.13, -0.3, 0.04, ("−0.13", "[−0.30, 0.04]")),
        (0.0, None, None, ("0", "")),
        (math.inf, None, None, ("∞", "")),
        (3.14159, math.nan, math.nan, ("3.14", "")),
        (5.0, 5.0, 5.0, ("5.00", "")),
    ],
)
def test_digits_follow_the_interval(value, low, high, expected):
    assert numbers.with_interval(value, low, high) == expected


def test_a_value_stays_inside_its_printed_interval():
    random = np.random.default_rng(1)
    for _ in range(2000):
        value = 10 ** random.uniform(-6, 7)
        low, high = value * random.uniform(0.2, 1), value * random.uniform(1, 4)
        text, interval = numbers.with_interval(value, low, high)
        shown = float(text.replace("−", "-"))
        bounds = [float(x) for x in interval.strip("[]").replace("−", "-").split(", ")]
        assert shown == pytest.approx(value, rel=0.06)
        assert bounds[0] * 0.95 <= shown <= bounds[1] * 1.05


def test_units():
    assert [numbers.duration(s) for s in (0, 2e-5, 0.05, 9.96, 80, 7300)] == [
        "0 s", "20 µs", "50 ms", "10.0 s", "1.3 min", "2.0 h",
    ]  # fmt: skip
    assert [numbers.count(n) for n in (0, 999, 18432, 1.5e6)] == ["0", "999", "18.4 k", "1.50 M"]
    assert [numbers.size(n) for n in (0, 512, 73728, 2**22)] == [
        "0 B", "512 B", "72.0 KiB", "4.00 MiB",
    ]  # fmt: skip
    assert [numbers.p_value(p) for p in (1e-9, 0.0234, 0.5)] == ["<0.001", "0.023", "0.50"]


# --- combining -----------------------------------------------------------------------------------


def test_geometric_mean_of_equal_numbers_narrows_with_the_root_of_n():
    one = Estimate(2.0, 1.8, 2.0**2 / 1.8)
    mean = geometric_mean([one] * 4, 4)
    assert mean.value == pytest.approx(2.0)
    assert math.log(mean.high / 2) == pytest.approx(math.log(one.high / 2) / 2)
    assert mean.note == ""
    assert "3 of 4" in geometric_mean([one] * 3, 4).note
    with pytest.raises(ValueError, match="positive and finite"):
        geometric_mean([one, Estimate(0.0)], 2)


def test_geometric_mean_covers_its_claim():
    random = np.random.default_rng(3)
    truth, sd, hits = np.array([0.5, 2.0, 7.0]), 0.1, 0
    for _ in range(600):
        seen = truth * np.exp(sd * random.standard_normal(3))
        factor = math.exp(1.96 * sd)
        mean = geometric_mean([Estimate(x, x / factor, x * factor) for x in seen], 3)
        hits += mean.low <= truth.prod() ** (1 / 3) <= mean.high
    assert 0.92 < hits / 600 < 0.98


def test_arithmetic_mean_and_ratio():
    mean = arithmetic_mean([Estimate(1.0, 0.0, 2.0), Estimate(-1.0, -2.0, 0.0)], 2)
    assert (mean.value, mean.high) == (0.0, pytest.approx(math.sqrt(2) / 2))
    quotient = ratio(Estimate(4.0, 2.0, 8.0), Estimate(2.0))
    assert (quotient.value, quotient.low) == (2.0, None)
    quotient = ratio(Estimate(4.0, 2.0, 8.0), Estimate(2.0, 1.0, 4.0))
    assert quotient.high == pytest.approx(2.0 * 2 ** math.sqrt(2))


def test_seeds_widen_the_interval_by_their_spread():
    alone = Estimate(1.0, 0.99, 1.01)
    assert over_seeds([alone]) is alone
    apart = over_seeds([Estimate(v, 0.99 * v, 1.01 * v) for v in (0.5, 1.0, 2.0)])
    assert apart.value == pytest.approx(1.0)
    assert apart.low < 0.7 and apart.high > 1.4
    together = over_seeds([alone] * 3)
    assert together.high - together.low < 0.02
    assert math.isinf(over_seeds([alone, Estimate(math.inf)]).value)


# --- bold ----------------------------------------------------------------------------------------


def bold(cells: list[Cell], best: str) -> list[bool]:
    return [cell.bold for cell in embolden(cells, best)]


def test_bold_needs_an_interval_clear_of_all_others():
    clear, near, low = Cell(3.0, 2.8, 3.2), Cell(2.9, 2.7, 3.1), Cell(1.0, 0.9, 1.1)
    assert bold([clear, low], "high") == [True, False]
    assert bold([clear, low], "low") == [False, True]
    assert bold([clear, low], "") == [False, False]
    assert bold([clear, near, low], "high") == [False, False, False]
    assert bold([Cell(3.0), low], "high") == [False, False]
    assert bold([clear], "high") == [False]
    # The best number overlaps not the second but the third, whose interval is wide.
    wide = Cell(1.5, 0.1, 9.0)
    assert bold([clear, Cell(2.0, 1.9, 2.1), wide], "high") == [False, False, False]


def test_ceilings_warnings_and_gaps_do_not_compete():
    winner = Cell(2.0, 1.9, 2.1)
    cells = [
        Cell(9.0, 8.9, 9.1, ceiling=True),
        Cell(8.0, 7.9, 8.1, warning="differs", biased=True),
        Cell(missing="error"),
        Cell(math.inf),
        winner,
        Cell(1.0, 0.9, 1.1),
    ]
    assert bold(cells, "high") == [False, False, False, False, True, False]


def test_a_disturbed_number_wins_nothing_and_stands_in_the_way():
    winner, rest = Cell(2.0, 1.9, 2.1), Cell(1.0, 0.9, 1.1)
    better = Cell(2.5, 2.2, 2.8, warning="disturbed: interval wider than 10%")
    worse = Cell(1.5, 1.2, 1.8, warning="disturbed: interval wider than 10%")
    assert bold([winner, rest, better], "high") == [False, False, False]
    assert bold([winner, rest, worse], "high") == [True, False, False]
    assert bold([winner, rest, replace(worse, missing="error")], "high") == [True, False, False]


# --- the tables ----------------------------------------------------------------------------------


def test_table2_has_daggers_warnings_and_the_ceiling_last(failing: Path):
    table = table_of(failing, "table2")
    assert table.columns[-1] == "tabulated"
    assert table.columns[:4] == list(METHODS)[:4]
    assert cell_of(table, "veined-marble", "blinn-phong").missing == "error: it_broke & burned: 50%"
    assert "unsupported" in cell_of(table, "quilted-satin", "neural-spline-flow").missing
    for row, said in (("elephant-hide", "biased"), ("geometric mean", "biased on elephant-hide")):
        found = cell_of(table, row, "fan-baseline")
        assert found.biased and said in found.warning
    assert not cell_of(table, "veined-marble", "fan-baseline").biased
    assert "2 of 3" in cell_of(table, "geometric mean", "neural-spline-flow").warning
    baseline = cell_of(table, "elephant-hide", "improved-baseline")
    assert (baseline.parts, baseline.value) == (("1×", ""), 1.0)
    assert cell_of(table, "geometric mean", "improved-baseline").parts == ("1×", "")
    for said in ("8 interleaved rounds", "rofile quick", "Example CPU", "studio-sphere"):
        assert said in table.caption
    assert not any(c.bold for r in table.sections[0].rows for c in r.cells if c.ceiling)


def test_geometric_mean_row_is_that_of_the_column(failing: Path):
    table = table_of(failing, "table2")
    values = [cell_of(table, m, "cosine").value for m in MATERIALS[:3]]
    mean = cell_of(table, "geometric mean", "cosine")
    assert mean.value == pytest.approx(float(np.exp(np.mean(np.log(values)))))
    assert mean.low < mean.value < mean.high


def test_bias_is_corrected_over_the_whole_table(failing: Path):
    results = Results.load(failing)
    corrected = corrected_p(results)
    key = ("elephant-hide", "fan-baseline", "studio-sphere")
    assert corrected[key] == pytest.approx(1e-12 * len(corrected))
    table = table_of(failing, "bias")
    cell = cell_of(table, "elephant-hide", "fan-baseline")
    assert cell.parts[0] == "<0.001" and "z = 12.3" in cell.warning
    assert f"1 of {len(corrected)}" in table.caption
    assert "1 differed at first, and has the p-value of new renders" in table.caption


def test_pdf_sections_and_shares_without_contest(failing: Path):
    table = table_of(failing, "pdf")
    assert [s.title.split()[0] for s in table.sections][:2] == ["KL(p*", "χ²"]
    assert "64 held-out conditions" in table.caption
    shares = next(s for s in table.sections if "invalid" in s.title)
    assert not any(c.bold for r in shares.rows for c in r.cells)


def test_timing_gives_both_units(failing: Path):
    table = table_of(failing, "timing")
    per_spp, per_sample = (cell_of(table, "cosine", c) for c in ("ms per spp", "ns per sample"))
    assert per_sample.value == pytest.approx(per_spp.value * 1e6 / 32**2, rel=1e-6)
    assert per_sample.value == pytest.approx(95, rel=0.05)
    assert cell_of(table, "cosine", "parameters").parts[0] == "0"
    assert "32 × 32 pixels" in table.caption


def test_status_joins_what_failed_alike(failing: Path):
    table = table_of(failing, "status")
    assert len(table.sections[0].rows) == 2
    assert "fit, pdf, equal-spp" in cell_of(table, "quilted-satin", "measure").text
    assert "1 error" in table.caption and "6 unsupported" in table.caption


def test_equal_spp_without_a_timed_measure(tmp_path: Path):
    folder = Made(measures=("equal-spp",)).write(tmp_path)
    table = table_of(folder, "equal-spp")
    results = Results.load(folder)
    pair = [
        results.number("equal-spp", "variance", "brocade", m, "studio-sphere")
        for m in ("improved-baseline", "cosine")
    ]
    assert all(isinstance(p, str) for p in pair)  # not one of the three materials
    pair = [
        results.number("equal-spp", "variance", "veined-marble", m, "studio-sphere")
        for m in ("improved-baseline", "cosine")
    ]
    cell = cell_of(table, "veined-marble", "cosine")
    assert cell.value == pytest.approx(pair[0].value / pair[1].value)
    assert cell.low < cell.value < cell.high
    assert isinstance(part("tables", "table2")(results), str)


def test_two_scenes_and_two_seeds(tmp_path: Path):
    folder = Made(
        methods=["cosine", "improved-baseline", "native"],
        scenes=("studio-sphere", "patch"),
        seeds=(0, 1),
        measures=("fit", "equal-spp", "equal-time"),
    ).write(tmp_path)
    table = table_of(folder, "table2")
    assert [s.title for s in table.sections][:2] == ["studio-sphere", "patch"]
    assert "2 seeds" in table.caption
    timing = table_of(folder, "timing")
    assert "ms per spp patch" in timing.columns


def test_a_failed_seed_is_said(tmp_path: Path):
    made = Made(materials=["suede"], methods=["cosine"], seeds=(0, 1), measures=("pdf",))
    folder = made.write(tmp_path)
    results = Results.load(folder)
    frame = results.frame
    second = frame["seed"] == 1
    frame.loc[second, "status"], frame.loc[second, "reason"] = "timeout", "too slow"
    number = Results(folder, frame, results.plan).number("pdf", "kl", "suede", "cosine")
    assert isinstance(number, Estimate) and number.note == "1 of 2 seeds only; timeout: too slow"


def test_machines_are_not_compared_in_silence(tmp_path: Path):
    made = Made(materials=["suede"], measures=("equal-time",))
    made.write(tmp_path)
    other = Made(materials=["brocade"], measures=("equal-time",), machine={"cpu": "Other"})
    other.write(tmp_path / "other")
    mixed = Results.load(tmp_path)
    extra = Results.load(tmp_path / "other")
    for trial in extra.plan["trials"]:
        shutil.move(tmp_path / "other" / trial["trial"], tmp_path / trial["trial"])
    mixed.plan["trials"] += extra.plan["trials"]
    import pandas as pd

    both = Results(tmp_path, pd.concat([mixed.frame, extra.frame]), mixed.plan)
    table = part("tables", "timing")(both)
    assert isinstance(table, Table) and "not to be compared" in table.caption


def test_unfinished_runs_are_counted_not_listed(tmp_path: Path):
    folder = Made(not_run=("equal-time", "slices")).write(tmp_path)
    table = table_of(folder, "status")
    assert "30 not run yet" in table.caption and not table.sections
    assert "not run yet" in cell_of(table_of(folder, "table2"), MATERIALS[0], "cosine").missing


def test_everything_failed(tmp_path: Path):
    folder = Made(fail={(None, None, None): ("error", "no luck")}, materials=MATERIALS[:3]).write(
        tmp_path
    )
    said: list[str] = []
    files = reports.load(folder).write(said.append)
    assert files[0].name == "index.html"
    assert "†1" in printed(folder)
    assert any("figure images" in message for message in said)
    assert not list((folder / "report").glob("figures/*"))
    assert "all 3" in (folder / "report" / "status.md").read_text("utf-8")


# --- formats -------------------------------------------------------------------------------------


def weird_table() -> Table:
    cells = [
        Cell(1.5, 1.4, 1.6, suffix="×", bold=True),
        Cell(missing=f"error: {WEIRD}"),
        Cell(2.0, warning=f"note {WEIRD}"),
    ]
    rows = [Row(WEIRD, cells), Row("mean", cells, summary=True)]
    return Table("weird", WEIRD, f"About {WEIRD}.", "row", [WEIRD, "b-c", "d e"],
                 [Section(WEIRD, rows), Section("two", rows)])  # fmt: skip


def test_latex_escapes_everything():
    text = latex(weird_table())
    assert latex_escape("_&%#{}$") == r"\_\&\%\#\{\}\$"
    # No special character is left bare once the commands we write ourselves are gone.
    caption = re.search(r"\\caption\{(.*)\}$", text, re.M).group(1)
    assert not re.search(r"(?<!\\)[&%#_$]", caption.replace("$^\\dagger$", ""))
    assert text.count(r"\begin{") == text.count(r"\end{")
    assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")
    for rule in (r"\toprule", r"\midrule", r"\bottomrule"):
        assert rule in text


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
def test_latex_compiles(failing: Path, tmp_path: Path):
    reports.load(failing).write()
    (tmp_path / "weird.tex").write_text(latex(weird_table()), encoding="utf-8")
    tables = [*sorted((failing / "report").glob("*.tex")), tmp_path / "weird.tex"]
    inputs = "\n".join(rf"\input{{{path}}}\clearpage" for path in tables)
    head = r"\documentclass{article}\usepackage[T1]{fontenc}\usepackage{booktabs,graphicx}"
    (tmp_path / "all.tex").write_text(
        rf"{head}\begin{{document}}{inputs}\end{{document}}", encoding="utf-8"
    )
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"],
        cwd=tmp_path, capture_output=True, text=True, errors="replace",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull" not in done.stdout


def test_markdown_keeps_its_columns():
    text = markdown(weird_table())
    bars = [re.sub(r"\\\|", "", line).count("|") for line in text.splitlines() if line[:1] == "|"]
    assert set(bars) == {5}
    assert "†<sup>1</sup>" in text and "**1.50×** \\[1.40, 1.60\\]" in text


def test_csv_has_all_digits_and_no_gap(failing: Path):
    rows = list(csv.DictReader(io.StringIO(as_csv(table_of(failing, "table2")))))
    rows = [row for row in rows if "as published" not in row["section"]]
    assert len(rows) == 4 * 6
    assert all(value != "" for row in rows for key, value in row.items()
               if key not in ("section", "note"))  # fmt: skip
    broken = next(r for r in rows if r["row"] == "veined-marble" and r["column"] == "blinn-phong")
    assert (broken["value"], broken["note"]) == ("nan", "error: it_broke & burned: 50%")
    best = [r for r in rows if r["best"] == "yes"]
    assert best and all(float(r["ci_low"]) < float(r["value"]) for r in best if r["text"] != "1×")


class Balanced(HTMLParser):
    """Collects ids and links, and checks that every element is closed in order."""

    void = {"meta", "img", "wbr", "br", "link"}

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: set[str] = set()
        self.links: list[str] = []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids |= {given["id"]} if given.get("id") else set()
        self.links += [given[key] for key in ("href", "src") if given.get(key)]
        if tag not in self.void:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_html_is_balanced_and_escaped():
    text = html(weird_table())
    Balanced().feed(text)
    assert "<i>$" not in text and "&lt;i&gt;$" in text


def test_console_fits_any_width(tmp_path: Path):
    folder = Made(methods=list(METHODS), materials=MATERIALS, measures=("equal-time",)).write(
        tmp_path
    )
    for width in (120, 80, 40):
        text = printed(folder, width)
        assert max(len(line) for line in text.splitlines()) <= width
        assert "…" not in text
        for material in MATERIALS:
            assert material in text
    # Twelve by eleven fits 120 columns in one block, intervals as half-widths.
    first = printed(folder, 120).split("Improvement")[0]
    assert first.count("brocade") == 1 and "±" in first
    # With room, intervals are printed whole.
    assert "±" not in printed(folder, 200)


def test_console_says_a_legend_once(failing: Path):
    assert printed(failing).count("Bold: the best") == 1


def test_console_negative_interval():
    table = Table("t", "T", "c.", "row", ["a"], [Section("", [Row("r", [Cell(0.1, -0.2, 0.4)])])])
    out = io.StringIO()
    print_table(table, Console(file=out, width=60), set())
    assert "−0.20 to 0.40" in out.getvalue()


def test_footnotes_count_distinct_reasons():
    assert Footnotes.of(weird_table()).reasons == [f"error: {WEIRD}", f"note {WEIRD}"]


# --- figures -------------------------------------------------------------------------------------


def test_front_keeps_what_nothing_beats():
    def point(time: float, error: float) -> Point:
        return Point(MethodColumn("m", "m"), Estimate(time), Estimate(error))

    points = [point(1, 5), point(2, 6), point(3, 2), point(3, 1), point(9, 1)]
    assert _front(points) == [points[0], points[3]]


def test_looks_are_fixed_and_distinct(failing: Path, tmp_path: Path):
    few = looks(Results.load(failing))
    many = looks(
        Results.load(Made(methods=[*METHODS, "mine", "theirs"], measures=("pdf",)).write(tmp_path))
    )
    assert all(many[label] == look for label, look in few.items() if label != "fan-baseline")
    assert len({(x.colour, x.marker) for x in many.values()}) == len(many)
    assert len({x.colour for x in many.values()}) == len(many)


def test_image_helpers():
    image = np.full((32, 32, 3), 0.25)
    assert srgb(image, 4.0).max() == pytest.approx(1.0)
    assert exposure(image) == pytest.approx(4.0)
    noisy = image.copy()
    noisy[20:26, 4:10] += 1.0
    row, column = _worst_square([noisy, image], image, None)
    assert row <= 20 and row + 8 >= 26 and column <= 4 and column + 8 >= 10
    noisy[0:6, 20:26] += 0.5
    elsewhere = np.zeros((32, 32), bool)
    elsewhere[:12] = True
    row, column = _worst_square([noisy, image], image, elsewhere)
    assert row == 0 and column <= 20 and column + 8 >= 26


def test_thumbnails_are_of_the_materials_that_were_rendered(tmp_path: Path):
    """One sheet a scene; a biased method has no part in them."""
    made = Made(materials=MATERIALS[:7], bias={("cosine", MATERIALS[0]): 1e-9})
    results = Results.load(made.write(tmp_path))
    (sheet,) = part("figures", "materials")(results, Canvas(tmp_path))
    assert sheet.png.name == "materials-studio-sphere.png" and sheet.width == 6 * 165
    at = (MATERIALS[0], "cosine", "studio-sphere")
    before = reference(results, MATERIALS[0], "studio-sphere")
    results.stored(results.trials("equal-spp", *at)[0]).images["mean"][:] = 1e6
    np.testing.assert_array_equal(reference(results, MATERIALS[0], "studio-sphere"), before)


def test_images_of_another_size_are_no_reference(tmp_path: Path):
    """Equal samples at half the size: the figure is drawn, without the reference it would have."""
    results = Results.load(Made(materials=MATERIALS[:1]).write(tmp_path))
    for trial in results.trials("equal-spp"):
        images = results.stored(trial).images
        images["mean"] = images["mean"][::2, ::2]
    assert reference(results, MATERIALS[0], "studio-sphere").shape == (16, 16, 3)
    drawn = part("figures", "images")(results, Canvas(tmp_path))
    assert [each.png.name for each in drawn][:1] == [f"images-studio-sphere-{MATERIALS[0]}.png"]


def test_grids_are_full():
    assert [grid_shape(n) for n in (1, 4, 5, 12, 13)] == [(1, 1), (1, 4), (2, 3), (3, 4), (4, 4)]


def test_time_per_sample_carries_its_interval(failing: Path):
    found = nanoseconds_per_sample(Results.load(failing), "suede", "cosine", "studio-sphere")
    assert isinstance(found, str)
    found = nanoseconds_per_sample(
        Results.load(failing), "elephant-hide", "cosine", "studio-sphere"
    )
    assert found.low < found.value < found.high


def test_figures_say_why_they_are_not_there(tmp_path: Path):
    results = Results.load(Made(measures=("fit",)).write(tmp_path))
    for name, figure in parts("figures").items():
        assert "no trial" in figure.load()(results, Canvas(tmp_path)), name


def test_convergence_below_the_noise_or_without_repeats(failing: Path, tmp_path: Path):
    results = Results.load(failing)
    hopeless, single = results.trials("convergence", MATERIALS[0])[:2]
    results.arrays(hopeless)["mse"][:] = -1.0
    for name in ("mse_low", "mse_high"):
        results.arrays(single)[name][:] = math.nan
    for trial in results.trials("convergence", MATERIALS[1]):
        results.arrays(trial)["mse"][:] = -1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drawn = part("figures", "convergence")(results, Canvas(tmp_path))
    assert drawn[0].png.is_file()


def test_infinite_divergence_is_named_not_drawn(failing: Path, tmp_path: Path):
    results = Results.load(failing)
    frame = results.frame.copy()
    rows = (frame["metric"] == "chi2") & (frame["method"] == "cosine")
    frame.loc[rows, ["value", "ci_low", "ci_high"]] = math.inf
    changed = Results(failing, frame, results.plan)
    with styled():
        drawn = part("figures", "tradeoff")(changed, Canvas(tmp_path))
    assert drawn[0].png.stat().st_size > 10_000
    assert cell_of(part("tables", "pdf")(changed), MATERIALS[0], "cosine", 1).parts[0] == "∞"
    mean = cell_of(part("tables", "pdf")(changed), "geometric mean", "cosine", 1)
    assert "not positive and finite" in mean.missing


# --- the whole report ----------------------------------------------------------------------------


def test_make_writes_a_page_whose_links_lead_somewhere(failing: Path):
    said: list[str] = []
    files = reports.load(failing).write(said.append)
    report = failing / "report"
    assert files[0] == report / "index.html" and all(path.is_file() for path in files)
    for name in ("table2", "equal-spp", "pdf", "bias", "timing", "status"):
        for end in ("md", "csv", "tex"):
            assert report / f"{name}.{end}" in files
    for name in ("tradeoff", "convergence", "slices"):
        assert report / "figures" / f"{name}.pdf" in files
    parser = Balanced()
    text = files[0].read_text("utf-8")
    parser.feed(text)
    assert not parser.open
    for link in parser.links:
        if link.startswith("#"):
            assert link[1:] in parser.ids, link
        else:
            assert (report / link).exists(), link
    assert "<script" not in text and "http" not in text
    assert "harness run suites/synthetic.yaml --profile quick" in text
    assert "it_broke &amp; burned" in text


def test_a_report_made_again_is_the_same(tmp_path: Path):
    folder = Made(materials=["suede"], methods=["cosine", "improved-baseline"]).write(tmp_path)
    first = {path: path.read_bytes() for path in reports.load(folder).write()}
    second = {path: path.read_bytes() for path in reports.load(folder).write()}
    assert first == second


def test_stale_files_go_others_stay(tmp_path: Path):
    folder = Made(materials=["suede"]).write(tmp_path)
    before = reports.load(folder).write()
    mine = folder / "report" / "notes.txt"
    mine.write_text("mine", encoding="utf-8")
    Made(materials=["suede"], measures=("fit",)).write(folder)
    after = reports.load(folder).write()
    gone = set(before) - set(after)
    assert gone and not any(path.exists() for path in gone)
    assert mine.read_text(encoding="utf-8") == "mine"


def test_the_suite_chooses(tmp_path: Path):
    report = {"tables": ["pdf"], "figures": ["slices"]}
    folder = Made(materials=["suede"], report=report).write(tmp_path)
    written = {path.stem for path in reports.load(folder).write()}
    assert written == {"index", "pdf", "status", "slices"}


def test_unknown_names_are_refused(tmp_path: Path):
    folder = Made(materials=["suede"], measures=("fit",), report={"tables": ["tabel2"]}).write(
        tmp_path
    )
    with pytest.raises(InputError, match="did you mean 'table2'"):
        reports.load(folder).print(Console(file=io.StringIO()))


def test_no_results_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="holds no results"):
        reports.load(tmp_path).write()


def test_odd_names_pass_through_everything(tmp_path: Path):
    folder = Made(
        materials=[WEIRD], methods=["cosine", "improved-baseline", WEIRD], title=WEIRD, size=24
    ).write(tmp_path)
    files = reports.load(folder).write()
    assert all(path.is_relative_to(folder / "report") for path in files)
    Balanced().feed(files[0].read_text("utf-8"))
    assert WEIRD in printed(folder)


def test_the_report_imports_nothing_that_measures():
    code = (
        "import sys, harness.report.write, harness.report.page;"
        "from harness.report.parts import KINDS, parts;"
        "[p.load() for kind in KINDS for p in parts(kind).values()];"
        "bad = [m for m in sys.modules if m.split('.')[0] in ('mitsuba', 'drjit')"
        " or m.startswith(('harness.measures', 'harness.rendering', 'harness.materials'))];"
        "sys.exit(str(bad) if bad else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_twelve_by_eleven(tmp_path: Path):
    folder = Made(materials=MATERIALS, methods=list(METHODS)).write(tmp_path)
    files = reports.load(folder).write()
    assert len([path for path in files if path.name.startswith("images-")]) == 12
