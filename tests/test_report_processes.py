"""A report that is made in several processes is the one that is made in one."""

from __future__ import annotations

import subprocess
import sys
import threading
from functools import partial

import pytest

from harness.core import workers
from harness.core.paths import ROOT

_POOLS = """
import os, sys
from functools import partial
import numpy as np
from harness.analysis import factors
from harness.stats.variance import Deviations
from harness.store.stored import LABELS, Stored

def arrays(seed, *_):
    rng = np.random.default_rng(seed)
    y = rng.gamma(0.2, 1 + seed % 3, size=(6, 64))
    return {
        "deviations": Deviations.of(y).packed(), "batch_variance": y.mean(1), "spp": np.array(96),
        "batch_spp": np.array(16), "pixels": np.full((2, 2), 16), "round_spp": np.array(16),
        "block_variance": y.reshape(6, 4, 16).mean(2), "compared": np.array(True),
        "seconds": rng.gamma(9.0, size=6), "baseline_seconds": rng.gamma(9.0, size=6),
    }

rows, trials = [], {}
for number in range(80):
    for measure in ("equal-spp", "equal-time"):
        labels = dict(zip(LABELS, ("s", f"m{number // 8}", f"a{number % 4}", "", measure, 0)))
        labels["scene"] = f"scene{number // 4 % 2}"
        key = f"{number}-{measure}"
        record = {"metric": "speedup-equal-spp", "value": 0.0, "ci_low": 0.0, "ci_high": 0.0}
        reader = partial(arrays, number + 1000 * (measure == "equal-time"))
        trials[key] = Stored(key, {}, labels, "ok", "", records=[record], reader=reader)
        rows.append({"trial": key, **labels})

forks = []
os.register_at_fork(before=lambda: forks.append(1))
made = []
for cores in ({0}, {0, 1}):
    os.sched_getaffinity = lambda process: cores
    found = factors.pooled({"trials": rows}, trials, "a0")
    assert bool(forks) == (len(cores) > 1)
    assert len(found.found) == 180 and not found.undiagnosed
    values = {key: (one.log, one.resolved, one.note) for key, one in found.found.items()}
    made.append((values, {key: trial.records for key, trial in found.trials.items()}))
assert str(made[0][1]) == str(made[1][1]) and any(one.resolved for one in found.found.values())
assert {k: str(v) for k, v in made[0][0].items()} == {k: str(v) for k, v in made[1][0].items()}
"""


def test_speed_ups_are_the_same_in_one_process_and_in_several():
    """In a process without torch, which would run threads."""
    done = subprocess.run(
        [sys.executable, "-c", _POOLS], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


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
