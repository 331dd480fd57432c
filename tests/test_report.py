"""The report: from stored results to tables, figures and the page, failures included."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from harness.core.protocol.errors import InputError
from harness.report import write as reports
from tests.report_reading import WEIRD, Balanced, page_data, printed
from tests.report_results import MATERIALS, METHODS, Made

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
        drawn = [path for path in files if path.parent.name == "figures" and name in path.name]
        assert {path.suffix for path in drawn} == {".pdf", ".png"}
    parser = Balanced()
    text = files[0].read_text("utf-8")
    parser.feed(text)
    assert not parser.open and not parser.links
    data = page_data(text)
    for figure in data["figures"]:
        assert all((report / "figures" / name).is_file() for name in figure["files"])
    assert data["command"] == "harness run suites/synthetic.yaml --profile quick"
    notes = [note for table in data["tables"] for note in table["notes"]]
    assert "error: it_broke & burned: 50%" in notes


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
        "import sys, harness.report.write, harness.report.page.build;"
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
    names = {path.name for path in files if path.name.startswith("images-")}
    # Twelve materials are more than one page has room for.
    pages = {name.removesuffix(".pdf") for name in names if name.endswith(".pdf")}
    assert len(pages) > 1 and all(f"{page}.png" in names for page in pages)
