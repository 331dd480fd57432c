"""A wheel works away from the clone: suites and methods by name, and nothing but ``harness``."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from harness import __version__
from harness.core import registry
from harness.suite import load

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's content, built of a copy of the sources."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for top in ("harness", "methods", "suites"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / top, source / top, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    command += ["--quiet", "--wheel-dir", str(out), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,) = out.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(out / "site")
    return out / "site"


def python(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Run Python in ``folder`` with the unpacked wheel ahead of what is installed."""
    environment = os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{folder}"}
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_it_has_one_package_and_its_data(unpacked: Path):
    tops = {p.name for p in unpacked.iterdir() if not p.name.endswith(".dist-info")}
    assert tops == {"harness"}
    (about,) = unpacked.glob("*.dist-info")
    assert f"Version: {__version__}" in (about / "METADATA").read_text("utf-8")
    assert "harness = harness.cli.main:main" in (about / "entry_points.txt").read_text("utf-8")
    inside = unpacked / "harness"
    for folder, at in (("methods", "_methods"), ("suites", "_suites")):
        for file in (ROOT / folder).rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                copy = inside / at / file.relative_to(ROOT / folder)
                assert copy.read_bytes() == file.read_bytes(), copy
    fits = [sorted(p.name for p in at.glob("fitted/*")) for at in (inside, ROOT / "harness")]
    assert fits[0] == fits[1]


def test_it_runs_away_from_the_clone_beside_another_methods_package(unpacked, tmp_path):
    """A user's own package of that name is his; the shipped methods are found all the same."""
    own = tmp_path / "methods"
    own.mkdir()
    (own / "__init__.py").write_text("MINE = 1\n")
    code = f"""
import methods, harness
from harness.core import registry
from harness.suite import load
assert harness.__file__.startswith({str(unpacked)!r}), harness.__file__
assert methods.MINE == 1
assert registry.names() == {registry.names()}
assert load.names() == {load.names()}
for name in registry.names():
    assert registry.make(name).name == name
load.load("effects")
assert methods.MINE == 1
"""
    done = python(unpacked, tmp_path, "-c", code)
    assert done.returncode == 0, done.stderr


def test_a_suite_by_name(unpacked, tmp_path):
    command = ("-m", "harness", "run", "smoke", "--only", "method=cosine,measure=pdf")
    done = python(unpacked, tmp_path, *command)
    assert done.returncode == 0, done.stderr + done.stdout
    assert (tmp_path / "results" / "smoke" / "results.sqlite").is_file()
    listed = python(unpacked, tmp_path, "-m", "harness", "status", "results/smoke")
    assert "stale" not in listed.stdout and "valid" in listed.stdout
