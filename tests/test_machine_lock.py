"""Timed work is alone, and untimed work that keeps coming does not keep it out."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

import pytest

from harness.runner.machine_lock import machine

LONG = 20.0
"""Seconds to wait for what has to happen; a failure takes as long."""


@pytest.fixture(autouse=True)
def of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No other run on this machine takes part."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


class Worker(threading.Thread):
    """Holds the machine until told to leave."""

    def __init__(self, alone: bool):
        super().__init__(daemon=True)
        self.alone = alone
        self.waiting, self.inside, self.leave = (threading.Event() for _ in range(3))
        self.start()

    def run(self) -> None:
        with machine(lambda text: self.waiting.set(), self.alone):
            self.inside.set()
            self.leave.wait(LONG)

    def end(self) -> None:
        self.leave.set()
        self.join(LONG)
        assert not self.is_alive()


def test_untimed_work_goes_on_together() -> None:
    workers = [Worker(alone=False) for _ in range(2)]
    assert all(worker.inside.wait(LONG) for worker in workers)
    for worker in workers:
        worker.end()


def test_a_timing_is_alone_and_comes_before_untimed_work_that_came_later() -> None:
    first = Worker(alone=False)
    assert first.inside.wait(LONG)
    timing = Worker(alone=True)
    assert timing.waiting.wait(LONG)
    late = Worker(alone=False)
    assert late.waiting.wait(LONG)
    assert not timing.inside.is_set() and not late.inside.is_set()
    first.end()
    assert timing.inside.wait(LONG) and not late.inside.is_set()
    timing.end()
    assert late.inside.wait(LONG)
    late.end()
