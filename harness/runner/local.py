"""Tasks carried out by worker processes of this machine, each with limits, none with another's.

Methods that come with the harness share a worker, as long as none leaves a trace; any other has one
of its own. A worker is kept for the next task of its owner. One that died, was ended, or whose
global state a method changed, is replaced.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Self

from harness.runner import forking
from harness.runner.forking import ForkServer, ServerLost
from harness.runner.limits import Limits, resident
from harness.runner.task import Answer, Task

KEPT = 4
"""Idle workers that are kept besides as many as there are slots."""
TRIES = 3
"""Of a task whose worker was killed: by a user, or by the system when memory ran out."""
_TICK, _WAIT = 0.25, 1.0


@dataclass
class _Worker:
    number: int
    pid: int
    connection: Connection
    owner: str
    material: str = ""
    busy: _Busy | None = None
    used: float = 0.0


@dataclass
class _Busy:
    number: int
    task: Task
    seconds: float
    began: float = math.inf
    """When the machine was free for it: until then it is not limited."""
    tries: int = 1


class Local:
    """See :class:`harness.runner.executor.Executor`."""

    isolated, timed_slots = True, 1

    def __init__(
        self,
        note: Callable[[str], None],
        device: str,
        slots: int,
        limits: Limits,
        share: int | None = None,
    ):
        """``share``: so many workers share the machine's memory, by default as many as slots."""
        self.note, self.device, self.slots, self.limits = note, device, slots, limits
        self.memory = limits.memory_of(share or slots)
        self.server: ForkServer | None = None
        self.workers: list[_Worker] = []
        self._looked = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if self.server is None:
            return
        try:
            for worker in list(self.workers):
                self._retire(worker)
            forking.give(self.server)
        except ServerLost:
            self.server.close()

    def submit(self, number: int, task: Task) -> None:
        """Hand it to a worker of its owner, one that has its material if there is one."""
        self._start(_Busy(number, task, self.limits.seconds_of(task)))

    def wait(self) -> list[tuple[int, Answer]]:
        """See :class:`harness.runner.executor.Executor`."""
        busy = {w.connection: w for w in self.workers if w.busy}
        if not busy:
            return []
        found = []
        end = time.monotonic() + _WAIT
        while not found and time.monotonic() < end:
            for connection in wait(list(busy), _TICK):
                found += self._heard(busy[connection])
            found += self._ended()
            busy = {w.connection: w for w in self.workers if w.busy}
        return found

    def rest(self) -> None:
        """End all workers, if none has work."""
        if not any(worker.busy for worker in self.workers):
            for worker in list(self.workers):
                self._retire(worker)

    # --- workers -------------------------------------------------------------------------------

    def _start(self, busy: _Busy) -> None:
        for _ in range(TRIES):
            try:
                worker = self._worker(busy.task)
                worker.connection.send_bytes(pickle.dumps(busy.task, protocol=5))
            except ServerLost:
                self._lost()
                continue
            except OSError:
                self._retire(worker)  # killed while it was idle
                continue
            busy.began = math.inf
            worker.busy, worker.material = busy, busy.task.first.material
            return
        raise RuntimeError("worker processes end as soon as they start")

    def _worker(self, task: Task) -> _Worker:
        idle = [w for w in self.workers if w.busy is None]
        own = [w for w in idle if w.owner == task.owner]
        if own:
            return max(own, key=lambda w: (w.material == task.first.material, w.used))
        for worker in sorted(idle, key=lambda w: w.used)[: max(0, len(idle) - KEPT)]:
            self._retire(worker)
        if self.server is None:
            self.server = forking.take(self.device)
        worker = _Worker(*self.server.fork(), owner=task.owner)
        self.workers.append(worker)
        return worker

    def _retire(self, worker: _Worker) -> forking.Ended:
        """End a worker with all that it started."""
        assert self.server is not None
        self.workers.remove(worker)
        worker.connection.close()
        return self.server.end(worker.number)

    def _lost(self) -> None:
        """The fork server was killed, and with it all workers: the tasks go to others."""
        assert self.server is not None
        workers, self.workers = self.workers, []
        for worker in workers:
            worker.connection.close()
        self.server.close()
        self.server = None
        for worker in workers:
            if worker.busy:
                self._start(worker.busy)

    def _heard(self, worker: _Worker) -> list[tuple[int, Answer]]:
        """A message of a busy worker, or its end."""
        busy = worker.busy
        assert busy is not None
        try:
            what, *rest = self._message(worker)
        except (EOFError, OSError):
            return self._died(worker)
        except Exception as error:  # of what a method made of its state or of its report
            kind = type(error).__name__
            answer = Answer(died=f"its outcome cannot be handed over: {kind}: {error}")
            self._retire(worker)
            return [(busy.number, answer)]
        if what == "begun":
            busy.began = time.monotonic()
        elif what == "note":
            self.note(*rest)
        elif what == "done":
            (answer,) = rest
            worker.busy, worker.used = None, time.monotonic()
            if answer.findings:
                self._retire(worker)
            return [(busy.number, answer)]
        return []

    @staticmethod
    def _message(worker: _Worker) -> Any:
        return pickle.loads(worker.connection.recv_bytes())

    def _died(self, worker: _Worker) -> list[tuple[int, Answer]]:
        """The worker ended by itself, or somebody ended it."""
        busy = worker.busy
        assert busy is not None
        try:
            ended = self._retire(worker)
        except ServerLost:
            self.workers.append(worker)
            self._lost()
            return []
        if ended.status == signal.SIGKILL and busy.tries < TRIES:
            busy.tries += 1
            self._start(busy)
            return []
        return [(busy.number, Answer(died=how(ended.status, busy.tries), said=ended.said))]

    def _ended(self) -> list[tuple[int, Answer]]:
        """End tasks that passed a limit."""
        found = []
        now = time.monotonic()
        look = now - self._looked >= _TICK
        if look:
            self._looked = now
        for worker in [w for w in self.workers if w.busy]:
            busy = worker.busy
            assert busy is not None
            why, status = "", "timeout"
            if now - busy.began > busy.seconds:
                why = f"ended after {busy.seconds:.3g} s, the limit of this trial"
            elif look and (size := resident(worker.pid)) > self.memory:
                why = f"ended at {_gib(size)}; its limit is {_gib(self.memory)}"
                status = "error"
            if why:
                said = self._retire(worker).said
                found.append((busy.number, Answer(died=why, status=status, said=said)))
        return found


def how(status: int, tries: int = 1) -> str:
    """How a process ended by itself, from its wait status."""
    times = f", {tries} times" if tries > 1 else ""
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        more = "; the memory may have run out" if name == "SIGKILL" else ""
        return f"its process was ended by {name}{times}{more}"
    return f"its process left with exit status {os.WEXITSTATUS(status)} in the middle of it{times}"


def _gib(size: float) -> str:
    return f"{size / 2**30:.3g} GiB"
