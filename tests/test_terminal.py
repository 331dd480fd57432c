"""What is printed does nothing to a terminal, in any encoding; an output that fails is one line."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.table import Table
from rich.text import Text

from harness.cli.main import main
from harness.core.protocol.errors import InputError, Mistakes
from harness.core.terminal import Screen, guarded
from harness.core.text import one_line, printable, unprintable
from harness.report.formats import csv, latex, markdown
from harness.report.table import Cell, Row, Section
from harness.report.table import Table as Numbers
from harness.store.folder import ResultsFolder
from tests import stores

HOSTILE = "a\x1b]0;owned\x07b\x1b[2Jc\rd\x00e\x9b31mf\u202eg\u2028h"
ANY = st.text(st.characters(), max_size=40)


@given(ANY)
def test_printable_text_has_nothing_unprintable_and_else_stays(text: str):
    found = printable(text)
    assert not any(unprintable(c) for c in found if c not in "\n\t")
    assert "\n" not in one_line(text)
    if not any(unprintable(c) for c in text):
        assert found == text
    found.encode("utf-8")  # no half of a surrogate pair is left


@given(ANY)
def test_a_refusal_is_one_printable_line(text: str):
    for error in (InputError(text), Mistakes([text, "x"])):
        assert not any(unprintable(c) for c in str(error))


def test_a_long_refusal_is_cut_in_the_middle():
    said = str(InputError(f"begin {'x' * 10_000} end"))
    assert len(said) < 2000 and said.startswith("begin") and said.endswith("end")


def test_a_screen_prints_names_as_they_are_and_keeps_its_colours():
    out = io.StringIO()
    screen = Screen(
        file=out, force_terminal=True, width=200, color_system="standard", highlight=False
    )
    table = Table()
    table.add_column(HOSTILE)
    table.add_row(Text(HOSTILE, style="red"))
    screen.print(table, Text(HOSTILE), HOSTILE, markup=False)
    text = out.getvalue()
    assert "\x1b[31m" in text, "its own sequences are meant"
    for sequence in ("\x1b]0;", "\x1b[2J", "\r", "\0", "\x9b", "\u202e", "\x07"):
        assert sequence not in text
    assert text.count("a\\x1b]0;owned") == 4, "in the head, the cell and two texts"


def test_prints_are_guarded_and_consoles_of_rich_get_through(capsys: pytest.CaptureFixture[str]):
    with guarded():
        print(HOSTILE)
        print(HOSTILE, file=sys.stderr)
        Console(force_terminal=True, color_system="standard").print("x", style="red")
    out, error = capsys.readouterr()
    assert "\x1b]0" not in out + error and out.count("\\x1b]0;owned") == 1
    assert "\x1b[31mx" in out


def test_names_of_a_store_reach_no_terminal_and_no_file_raw(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = tmp_path / "out"
    stores.make(folder)
    with ResultsFolder(folder, write=True) as store:
        plan = store.plan()
        for row in plan["trials"]:
            row["method"] = f"{HOSTILE}{row['method']}"
            row["material"] = HOSTILE
        head = {k: v for k, v in plan.items() if k != "trials"} | {"title": HOSTILE}
        store.write_plan(head, plan["trials"])
    for arguments in (["report"], ["status"], ["compare", str(folder)]):
        main([*arguments, str(folder)])
        out, error = capsys.readouterr()
        assert not [c for c in out + error if unprintable(c) and c not in "\n\t"]
    for path in (folder / "report").rglob("*"):
        if path.suffix in (".md", ".csv", ".tex", ".html"):
            text = path.read_bytes().decode("utf-8")
            assert not [c for c in text if unprintable(c) and c not in "\n\t"], path


def test_no_file_of_a_table_has_a_name_raw():
    name = f"=1+1 & <b> $x$ {HOSTILE}"
    cells = [Cell(-1.5, text="-1.5"), Cell(missing=name), Cell(1.0, warning=name)]
    table = Numbers(
        "x", name, name, name, ["=1+1", "+x", "@y"], [Section(name, [Row(name, cells)])]
    )
    for form in (csv.csv, latex.latex, markdown.markdown):
        text = form(table)
        assert not [c for c in text if unprintable(c) and c not in "\n\t"], form
    assert r"\&" in markdown.markdown(table) and "<b>" not in markdown.markdown(table)
    lines = csv.csv(table).splitlines()
    assert "'=1+1" in lines[1] and ",-1.5," in lines[1]
    assert not any(field[:1] in "=@+" for line in lines for field in line.split(",") if field)


@pytest.mark.parametrize(
    ("text", "kept"),
    [("-1.5", True), ("+1e-3", True), ("=1", False), ("-x", False), ("+1+1", False), ("a", True),
     ("@x", False), ("\t=1", False), ("", True)],
)  # fmt: skip
def test_a_formula_is_told_from_a_number(text: str, kept: bool):
    assert csv.plain(text) == (text if kept else f"'{text}")


def harness(arguments: list[str], **options) -> subprocess.CompletedProcess[str]:
    environment = os.environ | options.pop("env", {})
    return subprocess.run(
        [sys.executable, "-m", "harness", *arguments],
        env=environment, text=True, check=False, timeout=120, **options,
    )  # fmt: skip


def test_an_ascii_terminal_gets_ascii():
    code = (
        "from harness.core.terminal import Screen, guarded\n"
        "with guarded():\n    print('†±∞é')\n    Screen().print('†±∞é', '│')"
    )
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "LANG": "C", "LC_ALL": "C"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "\\u2020\\xb1\\u221e\\xe9\n\\u2020\\xb1\\u221e\\xe9 \\u2502\n"


def test_a_full_output_and_a_closed_pipe_are_one_line(tmp_path: Path):
    with open("/dev/full", "w") as full:
        done = harness(["list", "metrics"], stdout=full, stderr=subprocess.PIPE)
    expected = "error: the output cannot be written: No space left on device; what was stored is"
    assert (done.returncode, done.stderr) == (1, f"{expected} kept\n")
    here, there = os.pipe()
    os.close(here)
    done = harness(["list", "metrics"], stdout=there, stderr=subprocess.PIPE)
    os.close(there)
    assert done.returncode == 1
    assert (
        done.stderr == "error: the output cannot be written: Broken pipe; what was stored is kept\n"
    )


def test_a_disk_that_is_full_while_a_report_is_written(tmp_path: Path):
    """It is one line, and what is stored can be reported afterwards."""
    folder = stores.make(tmp_path / "out")
    before = (folder / "results.sqlite").read_bytes()
    code = (
        "import resource, sys; from harness.cli.main import main;"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (900, 900)); sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "report", str(folder)],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert (
        done.stderr.count("\n") == 1
        and "File too large; what is stored is untouched" in done.stderr
    )
    assert (folder / "results.sqlite").read_bytes() == before
    assert main(["report", str(folder)]) == 0
