"""A table as LaTeX, Markdown, CSV, HTML and on the console."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from rich.console import Console

from harness.report import write as reports
from harness.report.formats.console import print_table
from harness.report.formats.csv import csv as as_csv
from harness.report.formats.latex import escape as latex_escape
from harness.report.formats.latex import latex
from harness.report.formats.markdown import markdown
from harness.report.table import Cell, Footnotes, Row, Section, Table
from tests.report_reading import WEIRD, printed, table_of
from tests.report_results import MATERIALS, METHODS, Made

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
