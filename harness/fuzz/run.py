"""Hands seeds to a worker, watches it, and says what was neither accepted nor refused in a line."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

PATIENCE, ASLEEP = 10.0, 60.0
"""Seconds for one input: of the processor, and on the clock, for one that waits for something."""
_GLANCE = 2.0
"""Seconds between two looks at a worker that is silent."""
_STARTING = 300.0


@dataclass
class Result:
    """How many inputs were ``accepted``, ``refused`` and ``wrong``; and what was, by seed."""

    counts: Counter[str] = field(default_factory=Counter)
    wrong: dict[int, str] = field(default_factory=dict)
    slowest: float = 0.0
    lines: Counter[str] = field(default_factory=Counter)
    """Refusals, without what differs from input to input, by how often."""


class Worker:
    """A process that tries inputs (:mod:`harness.fuzz.worker`)."""

    def __init__(self, kind: str):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "harness.fuzz.worker", kind],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._line(_STARTING)

    def attempt(self, seed: int) -> dict[str, str]:
        """What came of the input with this seed; a hang or an end of the process is wrong."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(f"{seed}\n")
            self.process.stdin.flush()
            line = self._answer()
        except BrokenPipeError:
            line = ""
        if line is None:
            self.end()
            said = f"no answer after {PATIENCE:g} s of work or {ASLEEP:g} s"
            return {"kind": "wrong", "text": said}
        if not line:
            status = self.process.wait()
            return {"kind": "wrong", "text": f"the process ended with status {status}"}
        return json.loads(line)

    def _answer(self) -> str | None:
        begun, worked = time.monotonic(), self._seconds()
        while True:
            line = self._line(_GLANCE)
            late = time.monotonic() - begun > ASLEEP or self._seconds() - worked > PATIENCE
            if line is not None or late:
                return line

    def _seconds(self) -> float:
        """Of the processor, that the process has taken; 0 once it has ended."""
        try:
            text = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:
            return 0.0
        user, system = text.rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    def end(self) -> None:
        """Kill it and what it began."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def _line(self, seconds: float) -> str | None:
        """The next line; None if there is none in time, "" at the end."""
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], seconds)
        return self.process.stdout.readline() if ready else None


def run(
    kind: str,
    count: int,
    seconds: float = float("inf"),
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
) -> Result:
    """Try ``count`` inputs, of the seeds from ``seed`` on, or as many as ``seconds`` allow."""
    result, worker = Result(), Worker(kind)
    start = said = time.monotonic()
    try:
        for number in range(seed, seed + count):
            if time.monotonic() - start > seconds:
                break
            if not worker.alive:
                worker = Worker(kind)
            began = time.monotonic()
            found = worker.attempt(number)
            now = time.monotonic()
            result.slowest = max(result.slowest, now - began)
            result.counts[found["kind"]] += 1
            if found["kind"] == "wrong":
                result.wrong[number] = found["text"]
                say(f"seed {number}: {found['text'].strip().splitlines()[-1]}")
            elif found["text"]:
                result.lines[_shape(found["text"])] += 1
            if now - said > 60:
                said = now
                say(f"{result.counts.total()} of {count}: {_counted(result)}")
    finally:
        worker.end()
    return result


def _counted(result: Result) -> str:
    return ", ".join(f"{result.counts[k]} {k}" for k in ("accepted", "refused", "wrong"))


def _shape(line: str) -> str:
    return " ".join(w for w in line.split() if w.isalpha())[:80]
