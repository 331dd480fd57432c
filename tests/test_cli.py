"""The command line: verbs, exit statuses, and one clear line for what is refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from harness import load_results
from harness.cli.list import KINDS
from harness.cli.main import VERBS, main
from tests import fakes

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]):
    def check(*arguments: str) -> str:
        assert main(arguments) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("error: ")
        assert err.count("\n") == 1
        return err.removeprefix("error: ").strip()

    return check


def test_help_names_all_verbs(capsys: pytest.CaptureFixture[str]):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for verb in VERBS:
        assert f" {verb} " in text


def test_version(capsys: pytest.CaptureFixture[str]):
    from harness import __version__

    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == __version__


@pytest.mark.parametrize("kind", KINDS)
def test_list(kind: str, capsys: pytest.CaptureFixture[str]):
    assert main(["list", kind]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 2
    assert all(len(line.split()) >= 3 for line in lines), "a name and what it is"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["list", "method"], "list: cannot list 'method'; did you mean 'methods'?"),
        (["run"], "harness run: Missing argument"),
        (["run", "smoke", "--profle", "x"], "harness run: No such option: --profle"),
        (["run", "smok"], "no such suite: smok; did you mean 'smoke'?"),
        (["run", "smoke", "--executor", "dsk"], "unknown executor 'dsk'; did you mean 'dask'?"),
        (["run", "smoke", "--retry", "all"], "--retry all: expected 'failed'"),
        (["run", "smoke", "--device", "cpux"], "unknown device 'cpux'; did you mean 'cpu'?"),
        (["validate", "smok"], "no such suite: smok; did you mean 'smoke'?"),
        (["report", "nowhere/at-all"], "no such folder: nowhere/at-all"),
        (["rnu"], "harness: No such command 'rnu'"),
    ],
)
def test_refused_in_one_line(refused, arguments: list[str], message: str):
    assert refused(*arguments).startswith(message)


def test_report_of_no_results(refused, tmp_path: Path):
    assert refused("report", str(tmp_path)).endswith(
        "holds no results (there is no results.sqlite)"
    )


def test_unknown_part(refused):
    text = refused("run", "smoke", "--only", "material=brushed-metl")
    assert "did you mean 'brushed-metal'?" in text


def test_adapter_that_does_not_import(refused, capsys, tmp_path: Path):
    path = fakes.suite(tmp_path, materials=["suede"], scenes=None, measures=["pdf"])
    (tmp_path / "adapters.py").write_text("import nothing_of_that_name\n" + fakes.ADAPTERS)
    text = refused("run", str(path), "--out", str(tmp_path / "out"))
    assert "methods: 'Good': method" in text and "ModuleNotFoundError" in text
    # All mistakes are listed there, a line each.
    assert main(["validate", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) > 1 and all("ModuleNotFoundError" in line for line in lines)
    assert "methods: 'Good': method" in lines[0]


def test_unreadable_measured_file(refused, tmp_path: Path):
    broken = {"name": "paint", "type": "measured", "file": "paint.bsdf"}
    path = fakes.suite(tmp_path, materials=[broken], scenes=None, measures=["pdf"])
    (tmp_path / "paint.bsdf").write_bytes(b"not a tensor file")
    text = refused("run", str(path), "--out", str(tmp_path / "out"))
    assert "paint" in text


def test_importing_the_package_is_cheap():
    code = "import sys, harness, harness.cli.main; sys.exit('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False)
    assert done.returncode == 0


def test_omp_policy_is_set_before_torch():
    code = "import os, harness; print(os.environ['OMP_WAIT_POLICY'])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert done.stdout.strip() == "PASSIVE"


def test_the_whole_chain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], worker_processes: None
):
    """The smoke suite from YAML to the table, on real materials and methods."""
    out = tmp_path / "smoke"
    assert main(["validate", "smoke"]) == 0
    assert main(["run", "smoke", "--out", str(out)]) == 0
    first = capsys.readouterr().out
    frame = load_results(out)
    assert set(frame["status"]) == {"ok"}
    assert set(frame["suite"]) == {"smoke"}
    assert {"pdf", "equal-spp", "equal-time", "convergence", "slices", "fit"} == set(
        frame["measure"]
    )
    assert (out / "report").is_dir()
    table = first[first.index("Speed-up") : first.rindex("report: ")]
    assert main(["run", "smoke", "--out", str(out), "--dry-run"]) == 0
    assert "all stored" in capsys.readouterr().out
    assert main(["report", str(out)]) == 0
    assert table in capsys.readouterr().out
