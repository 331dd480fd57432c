"""Runs that are killed again and again: nothing is lost, nobody is left, the numbers stay."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from harness.runner.run import Options
from harness.store.damage import damage
from harness.store.folder import ResultsFolder
from tests.test_workers import LIMITS, ROOT, go, numbers, suite

MATERIALS = ["disney", "layered", "ggx-conductor", "constant"]
METHODS = ["cosine", "adapters.py:Good", "blinn-phong"]
TRIALS = 216
MEASURES = [
    {"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8},
    {"name": "throughput", "batch": 256, "rounds": 4, "least_seconds": 1e-4},
]


def of_run(folder: Path) -> list[int]:
    """Processes with this temporary folder in their environment: those of a run."""
    found = []
    for file in Path("/proc").glob("[0-9]*/environ"):
        try:
            if f"TMPDIR={folder}".encode() in file.read_bytes().split(b"\0"):
                found.append(int(file.parent.name))
        except OSError:
            continue
    return found


def killed_and_resumed(tmp_path: Path, kills: int, seeds: int) -> None:
    """A run that is killed ``kills`` times, whatever it does, against one that is not."""
    rng = random.Random(kills)
    changes = {"materials": MATERIALS, "methods": METHODS, "seeds": [*range(seeds)]}
    path = suite(tmp_path / "s", "1", [], measures=MEASURES, **changes)
    _, _, whole = go(path, Options(limits=LIMITS), out="whole")
    own = tmp_path / "own"
    own.mkdir()
    out = path.parent / "out"
    command = [sys.executable, "-m", "harness", "run", str(path), "--out", str(out)]
    environment = os.environ | {"TMPDIR": str(own), "PYTHONPATH": str(ROOT)}
    done = 0
    for _ in range(kills):
        process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
        end = time.monotonic() + 120
        # Killed a while after the first trial that it stored itself, or while it begins.
        while process.poll() is None and time.monotonic() < end and rng.random() > 0.002:
            if stored(out) > done:
                time.sleep(rng.random())
                break
            time.sleep(0.05)
        process.kill()
        process.wait()
        end = time.monotonic() + 20
        while of_run(own) and time.monotonic() < end:
            time.sleep(0.05)
        assert not of_run(own), "a process is left"
        assert stored(out) >= done, "what was stored is there"
        done = stored(out)
    code, text, found = go(path, Options(limits=LIMITS))
    assert code == 0, text
    with ResultsFolder(out) as store:
        assert damage(store) == {}
    assert set(found) == set(whole)
    assert {t.status for t in found.values()} == {"ok"}
    for method in ("cosine", "Good", "blinn-phong"):
        assert numbers(found, method) == numbers(whole, method) != {}


def stored(out: Path) -> int:
    """How many trials are stored."""
    if not (out / "results.sqlite").exists():
        return 0
    with ResultsFolder(out) as store:
        return len(store.keys())


@pytest.mark.slow
def test_fifty_kills_lose_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worker_processes: None
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    killed_and_resumed(tmp_path, kills=50, seeds=TRIALS // len(MATERIALS) // len(METHODS) // 3)
