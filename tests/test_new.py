"""``harness new method``: what it writes runs, and it replaces nothing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from harness.checks.run import run_checks
from harness.cli.new import register, scaffold
from harness.core import registry
from harness.core.protocol.errors import InputError
from tests.materials import Plain, Tilted

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("material", [pytest.param(Plain, marks=pytest.mark.slow), Tilted])
def test_the_scaffold_is_a_correct_sampler(material, tmp_path):
    made = scaffold("my-sampler", tmp_path)
    method = registry.make(made.handle)
    assert method.name == "my-sampler"
    assert [f.line() for f in run_checks(method, material()) if not f.ok] == []


@pytest.mark.slow
def test_its_test_passes_and_both_files_are_clean(tmp_path):
    made = scaffold("my-sampler", tmp_path)
    run = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider"]
    run.append(str(made.test_file))
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 passed" in done.stdout
    lint = [sys.executable, "-m", "ruff", "check", "--no-cache", "--config", "pyproject.toml"]
    lint += [str(made.method_file), str(made.test_file)]
    done = subprocess.run(lint, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_its_test_notices_a_wrong_density(tmp_path):
    made = scaffold("my-sampler", tmp_path)
    text = made.method_file.read_text()
    made.method_file.write_text(text.replace("return 0.5 * disk + 0.5", "return 0.5 * disk + 0.4"))
    findings = run_checks(registry.make(made.handle), Plain())
    assert any(not f.ok for f in findings)


@pytest.mark.parametrize(
    "name", ["", "My-Sampler", "my_sampler", "-x", "x-", "2d", "a/b", "../x", "a b", "class"]
)
def test_bad_names_are_refused(name, tmp_path):
    with pytest.raises(InputError, match="method name"):
        scaffold(name, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["method", "disk-sample", "cosine"])
def test_names_that_mean_something_already_are_refused(name, tmp_path):
    with pytest.raises(InputError, match=f"'{name}'"):
        scaffold(name, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("existing", ["methods/mine.py", "tests/test_mine.py"])
def test_existing_files_stay_as_they_are(existing, tmp_path):
    path = tmp_path / existing
    path.parent.mkdir()
    path.write_text("kept")
    with pytest.raises(InputError, match="exists already"):
        scaffold("mine", tmp_path)
    assert path.read_text() == "kept"
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [path]


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "methods").write_text("a file, not a folder")
    with pytest.raises(InputError, match="cannot write"):
        scaffold("mine", tmp_path)


def test_the_verb_says_what_it_wrote_and_what_comes_next(tmp_path):
    app = typer.Typer()
    register(app)
    result = CliRunner().invoke(app, ["new", "method", "mine", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    words = " ".join(result.output.split())
    assert f"wrote {tmp_path / 'methods' / 'mine.py'}" in words
    assert f"harness check {tmp_path / 'methods' / 'mine.py'}:Mine" in words


def test_the_method_in_the_readme_is_a_correct_sampler(tmp_path):
    readme = (ROOT / "README.md").read_text()
    code = re.search(r"```python\n(# methods/mirror_lobe.py\n.*?)```", readme, re.DOTALL)[1]
    file = tmp_path / "mirror_lobe.py"
    file.write_text(code)
    method = registry.make(f"{file}:MirrorLobe", sigma=0.3)
    assert [f.line() for f in run_checks(method, Plain()) if not f.ok] == []
    lines = [line for line in code.splitlines() if line.strip() and not line.startswith("#")]
    assert len(lines) <= 20
