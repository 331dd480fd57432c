"""How long and how large a task may get before it is ended."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from harness.core.protocol.errors import InputError
from harness.runner.fork_server import below
from harness.runner.task import CHECK, Task

MEASURE_SECONDS = 3600.0
"""Of a measure, for each of its trials."""
CHECK_SECONDS = 60.0
"""Of constructing a method."""
FIT_SECONDS, STEP_SECONDS, UNTIL = 600.0, 2.0, 64
"""Of a fit: so much, so much more for each step, and so many times the steps where it goes on until
it is converged."""
SLACK, GRACE = 1.5, 10.0
"""A fit that has a time limit of its own may pass it by this factor and these seconds: it is to
end by itself, and its data are not part of it."""
SHARE = 0.9
"""Of the memory that is free when a run starts: what all of its workers may have together."""
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Limits:
    """``seconds`` of each trial instead of the usual; ``memory`` in bytes of one worker."""

    seconds: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("--trial-seconds", self.seconds), ("--trial-memory", self.memory)):
            if value is not None and not value > 0:
                raise InputError(f"{name}: expected more than zero, got {value:g}")

    def seconds_of(self, task: Task) -> float:
        """Seconds after which ``task`` is ended."""
        if task.kind == CHECK:
            return min(CHECK_SECONDS, self.seconds or CHECK_SECONDS)
        if self.seconds is not None:
            return self.seconds * len(task.trials)
        return _of_fit(task) if task.is_fit else MEASURE_SECONDS * len(task.trials)

    def memory_of(self, workers: int) -> float:
        """Bytes of each of so many workers."""
        return self.memory if self.memory is not None else SHARE * available() / workers


def _of_fit(task: Task) -> float:
    budget = task.first.budget
    times = UNTIL if budget.until else 1
    if budget.max_seconds < float("inf"):
        return SLACK * budget.max_seconds * times + GRACE
    if budget.seconds:
        return SLACK * budget.seconds + FIT_SECONDS
    return FIT_SECONDS + STEP_SECONDS * budget.steps * times


def available() -> int:
    """Bytes of memory that can be had now, in this container where it says so."""
    found = [os.sysconf("SC_PHYS_PAGES") * _PAGE]
    info = Path("/proc/meminfo")
    if info.is_file():
        lines = dict(line.split(":", 1) for line in info.read_text().splitlines() if ":" in line)
        found.append(1024 * int(lines.get("MemAvailable", "0 kB").split()[0]))
    limit, used = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")
    if limit.is_file() and used.is_file() and (text := limit.read_text().strip()).isdigit():
        found.append(int(text) - int(used.read_text()))
    return max(1, min(found))


def resident(pid: int) -> int:
    """Bytes of memory of a process that are its own, and of all that it started."""
    return sum(_resident(each) for each in {pid, *below(pid)})


def _resident(pid: int) -> int:
    try:
        # What is mapped from files or shared, as the fork server's libraries, is not its own.
        _, pages, shared = Path(f"/proc/{pid}/statm").read_text().split()[:3]
    except OSError:
        return 0  # it has just ended
    return (int(pages) - int(shared)) * _PAGE
