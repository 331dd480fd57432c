"""A report that is made in several processes is the one that is made in one."""

from __future__ import annotations

import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import pytest

from harness.core import workers
from harness.core.paths import ROOT
from tests.report_results import MATERIALS, Made

_LOADS = """
import os, sys
from harness.analysis import factors
from harness.analysis.results import Results
from harness.core import workers
forked = []
os.register_at_fork(after_in_parent=lambda: forked.append(1))
if sys.argv[2] == "one":
    os.sched_getaffinity = lambda process: {0}
factors._MANY = 2
results = Results.load(sys.argv[1])
assert "torch" not in sys.modules, "reading results needs no torch"
found = {key: (one.interval, one.resolved, one.note) for key, one in results.factors.found.items()}
assert len(found) > 20
print(bool(forked), sorted(found.items()), results.frame.to_csv(float_format="%r"))
"""


def test_speed_ups_are_the_same_in_one_process_and_in_several(tmp_path: Path):
    folder = Made(
        materials=list(MATERIALS[:4]), measures=("fit", "equal-spp", "equal-time"), size=16
    ).write(tmp_path / "out")
    said = [
        subprocess.run(
            [sys.executable, "-c", _LOADS, str(folder), how],
            cwd=ROOT, capture_output=True, text=True, check=True,
        ).stdout.partition(" ")
        for how in ("one", "many")
    ]  # fmt: skip
    assert said[0][0] == "False" and said[1][0] in ("True", "False")
    assert said[0][2] == said[1][2]


def test_a_process_with_threads_or_a_daemon_works_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(workers, "_THREADED", ())
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        assert not workers._may_fork()
        tasks = {str(n): partial(int, n) for n in range(3)}
        told: list[str] = []
        assert workers.together(tasks, told.append) == {"0": 0, "1": 1, "2": 2}
        assert told == ["0", "1", "2"]
    finally:
        stop.set()
        thread.join()
