"""Every example runs, away from the clone, and leaves what it says."""

from __future__ import annotations

import ast
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
TEN = 10


def environment() -> dict[str, str]:
    """The harness under test, whatever is installed."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths), "MPLBACKEND": "agg"}


def test_there_are_some():
    assert len(SCRIPTS) >= 4 and NOTEBOOKS


def written(file: Path, folder: Path) -> None:
    """The files that a script says it writes are there."""
    for name in re.findall(r"writes ([\w.]+\w)", ast.get_docstring(ast.parse(file.read_text()))):
        assert (folder / name).stat().st_size > 500, name


def test_a_script_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    mi = pytest.importorskip("mitsuba")
    file = EXAMPLES / "own_method.py"
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(file), run_name="__main__")
    mi.Thread.wait_for_tasks()  # pictures are written meanwhile; the end of a process waits, too
    said = capsys.readouterr().out
    assert said.strip() and "nan" not in said
    written(file, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("file", SCRIPTS, ids=lambda file: file.stem)
def test_a_script(file: Path, tmp_path: Path):
    done = subprocess.run(
        [sys.executable, str(file)],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() and "nan" not in done.stdout
    written(file, tmp_path)


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_cells_of_a_notebook_in_this_process(
    file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """Its cells one after the other, as a kernel runs them, which takes ten seconds to start."""
    import matplotlib.pyplot as plt

    nbformat = pytest.importorskip("nbformat")
    book = nbformat.read(file, as_version=4)
    nbformat.validate(book)
    assert not any(cell.get("outputs") for cell in book.cells), "no results are kept"
    plt.switch_backend("agg")
    main = ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", main)
    monkeypatch.chdir(tmp_path)
    for cell in book.cells:
        if cell.cell_type == "code":
            exec(compile(cell.source, file.name, "exec"), vars(main))
    assert plt.get_fignums(), "a picture is drawn"
    plt.close("all")
    said = capsys.readouterr().out
    assert said.strip() and "nan" not in said


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
    book = nbformat.read(file, as_version=4)
    client.NotebookClient(book, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    kinds = {o.output_type for cell in book.cells for o in cell.get("outputs", ())}
    assert kinds >= {"display_data", "stream"}


def test_ten_lines_lead_to_a_picture_with_ones_own_method():
    """From ``import harness`` to the picture, in the notebook's first cell."""
    nbformat = pytest.importorskip("nbformat")
    cells = nbformat.read(EXAMPLES / "first_picture.ipynb", as_version=4).cells
    first = next(cell.source for cell in cells if cell.cell_type == "code")
    lines = [line for line in first.splitlines() if line.strip()]
    assert len(lines) <= TEN and any("harness.render" in line for line in lines)
