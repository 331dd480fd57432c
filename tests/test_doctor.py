"""What this machine can run: LLVM, the variant, and ``harness doctor``."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from harness.cli import doctor
from harness.core.protocol.errors import InputError
from harness.mitsuba_runtime import llvm, variant

ROOT = Path(__file__).parents[1]
NOWHERE = "/nowhere/libLLVM.so"


def elsewhere(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in a fresh process: Dr.Jit chooses its LLVM once for each."""
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize(
    ("version", "usable"),
    [
        (None, False),
        ((14, 0, 6), False),
        ((15, 0, 6), False),
        ((16, 0, 6), False),
        ((17, 0, 0), True),
        ((19, 1, 7), True),
        ((22, 1, 0), True),
    ],
)
def test_versions(version, usable, monkeypatch):
    monkeypatch.delenv(llvm.PATH_VARIABLE, raising=False)
    assert (llvm.problem(llvm.Library(version, "lib.so")) is None) is usable


def test_libraries_elsewhere_are_found_the_closest_to_the_tested_first(tmp_path, monkeypatch):
    monkeypatch.delenv("CONDA_PREFIX", raising=False)
    for name in ("libLLVM-15.so.1", "libLLVM-17.so.1", "libLLVM.so.18.1", "libLLVM.so.22.1"):
        (tmp_path / name).touch()
    (tmp_path / "libLLVM-18.so").symlink_to("libLLVM.so.18.1")
    (tmp_path / "libLLVM-19.so").symlink_to("gone.so")
    found = llvm.others((str(tmp_path),))
    assert [Path(lib.path).name for lib in found] == [
        "libLLVM.so.18.1",
        "libLLVM-17.so.1",
        "libLLVM.so.22.1",
    ]
    assert llvm.remedy(found) == f"export {llvm.PATH_VARIABLE}={tmp_path}/libLLVM.so.18.1"
    assert llvm.others((str(tmp_path / "absent"),)) == []


def test_an_unusable_library_is_refused_before_it_can_abort(monkeypatch):
    monkeypatch.setattr(llvm, "loaded", lambda: llvm.Library((15, 0, 6), "/lib/libLLVM-15.so"))
    monkeypatch.setattr(llvm, "others", list)
    with pytest.raises(InputError, match=r"LLVM 15\.0\.6 .*too old.*libllvm19"):
        llvm.require()


def test_the_library_in_use_is_named():
    library = llvm.require()
    assert library.version[0] >= llvm.OLDEST
    assert Path(library.path).is_file()


@pytest.mark.parametrize(
    ("version", "others", "status", "printed"),
    [
        ((19, 1, 7), [], 0, ""),
        ((15, 0, 6), [llvm.Library((18, 0, 0), "/x/libLLVM.so.18")], 3, "/x/libLLVM.so.18\n"),
        (None, [], 1, ""),
    ],
)
def test_what_the_set_up_script_is_told(version, others, status, printed, monkeypatch, capsys):
    monkeypatch.setattr(llvm, "loaded", lambda: llvm.Library(version))
    monkeypatch.setattr(llvm, "others", lambda: others)
    assert llvm.main() == status
    out, err = capsys.readouterr()
    assert out == printed
    assert bool(err) is (status == 1)


def test_a_missing_library_is_one_clear_line():
    code = "from harness.mitsuba_runtime.variant import use; use('cpu')"
    done = elsewhere(code, DRJIT_LIBLLVM_PATH=NOWHERE)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1
    assert "InputError" in last and NOWHERE in last


def test_the_variant_is_set_once_and_kept():
    code = """
from harness import InputError
from harness.mitsuba_runtime.variant import use
assert use("cpu").variant() == "llvm_ad_rgb"
assert use("cpu").variant() == "llvm_ad_rgb"
try:
    use("cuda")
except InputError as error:
    print(error)
"""
    done = elsewhere(code)
    assert done.returncode == 0, done.stderr
    assert "already runs llvm_ad_rgb" in done.stdout


def test_an_unknown_device_is_refused():
    with pytest.raises(InputError, match="did you mean 'cuda'"):
        variant.use("cuda0")


def app() -> typer.Typer:
    """A command line with this verb alone (the callback keeps it a verb)."""
    made = typer.Typer()
    made.callback()(lambda: None)
    doctor.register(made)
    return made


def test_this_machine_can_run_the_main_job():
    result = CliRunner().invoke(app(), ["doctor"])
    assert result.exit_code == 0, result.output
    for name in ("Python", "PyTorch", "Dr.Jit", "Mitsuba", "LLVM", "C++ compiler", "Memory"):
        assert name in result.output
    assert "can run the main job" in result.output


def test_a_machine_without_llvm_or_gpu_cannot(monkeypatch):
    monkeypatch.setattr(llvm, "loaded", lambda: llvm.Library(None))
    monkeypatch.setattr(llvm, "others", list)
    monkeypatch.setattr(doctor, "gpu_driver", lambda: None)
    result = CliRunner().invoke(app(), ["doctor"])
    assert result.exit_code == 1
    assert "libllvm19" in result.output
    assert "cannot render" in result.output


def test_a_missing_package_is_a_row_and_not_a_crash(monkeypatch):
    def imported(name):
        return "No module named 'mitsuba'" if name == "mitsuba" else importlib.import_module(name)

    monkeypatch.setattr(doctor, "_imported", imported)
    rows, able = doctor.examine()
    assert not able
    row = next(row for row in rows if row.name == "Mitsuba")
    assert (row.status, row.found) == (doctor.MISSING, "No module named 'mitsuba'")


def test_a_render_that_ends_its_process_is_reported(monkeypatch):
    monkeypatch.setattr(doctor, "TRIAL_RENDER", "import os; os.abort()")
    row = doctor.trial_render("llvm_ad_rgb")
    assert row.status == doctor.MISSING
    assert "signal 6" in row.found


def test_a_render_that_fails_gives_its_last_words(monkeypatch):
    monkeypatch.setattr(doctor, "TRIAL_RENDER", "raise SystemExit('no such variant')")
    row = doctor.trial_render("llvm_ad_rgb")
    assert (row.status, row.found) == (doctor.MISSING, "no such variant")


def test_an_idle_render_is_given_up(monkeypatch):
    monkeypatch.setattr(doctor, "TRIAL_RENDER", "import time; time.sleep(60)")
    monkeypatch.setattr(doctor, "TRIAL_SECONDS", 1)
    assert doctor.trial_render("llvm_ad_rgb").status == doctor.MISSING
