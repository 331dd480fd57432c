"""The process that worker processes are forked from: everything is imported there once.

It runs no code of an adapter, so that it always answers. It forks a worker when asked, ends one
with all that the worker started, and ends itself and all workers when its parent is gone, however
that went. Orphans of workers become its children (``PR_SET_CHILD_SUBREAPER``), so that none is
lost by a double fork.

One message is one JSON object over a ``SOCK_SEQPACKET`` socket. From the parent: ``{"fork": N}``
with one end of the worker's connection, ``{"end": N}``. To the parent: ``{"ready": true}`` or
``{"failed": TEXT}`` once, ``{"forked": N, "pid": P}``, ``{"ended": N, "status": S, "said": TEXT}``
with a wait status and the end of what the worker printed.
"""

from __future__ import annotations

import ctypes
import faulthandler
import json
import os
import selectors
import signal
import socket
import sys
from dataclasses import dataclass
from pathlib import Path

KEPT = 1 << 13
"""Bytes of a worker's output that are kept: the end of it."""
LONGEST = 1 << 16
"""Bytes of a message."""
_DEATH_SIGNAL, _SUBREAPER = 1, 36  # prctl(2)
_ROUNDS = 50
_CHUNK = 1 << 16


@dataclass
class _Forked:
    number: int
    pid: int
    output: int
    said: bytes = b""


class Server:
    """The loop of the process; ``control`` is the socket to the parent."""

    def __init__(self, control: socket.socket):
        self.control = control
        self.forked: dict[int, _Forked] = {}
        self.selector = selectors.DefaultSelector()
        self.selector.register(control, selectors.EVENT_READ)
        self.woken, wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        os.set_blocking(wake, False)
        self.wake = wake
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        self.selector.register(self.woken, selectors.EVENT_READ)

    def run(self) -> None:
        """Until the parent is gone."""
        while True:
            for key, _ in self.selector.select():
                if key.fileobj is self.control:
                    if not self._asked():
                        return
                elif key.fileobj == self.woken:
                    _drained(self.woken)
                    self._reap()
                elif key.data is not None and key.data.pid in self.forked:
                    self._listen(key.data)

    def close(self) -> None:
        """End all workers and what they started."""
        for worker in list(self.forked.values()):
            self._end(worker)

    # --- messages ------------------------------------------------------------------------------

    def _asked(self) -> bool:
        try:
            data, handed, _, _ = socket.recv_fds(self.control, LONGEST, 1)
        except OSError:
            return False
        if not data:
            return False
        asked = json.loads(data)
        if "fork" in asked:
            self._fork(asked["fork"], handed[0])
        else:
            for worker in [w for w in self.forked.values() if w.number == asked["end"]]:
                self._end(worker)
        return True

    def _say(self, **said: object) -> None:
        try:
            self.control.send(json.dumps(said).encode())
        except OSError:
            return  # the parent is gone, which the next read will say

    # --- workers -------------------------------------------------------------------------------

    def _fork(self, number: int, connection: int) -> None:
        here, there = os.pipe2(os.O_CLOEXEC)
        server = os.getpid()
        pid = os.fork()
        if pid == 0:
            self._become_worker(server, connection, there)
        os.close(connection)
        os.close(there)
        os.set_blocking(here, False)
        worker = _Forked(number, pid, here)
        self.forked[pid] = worker
        self.selector.register(here, selectors.EVENT_READ, worker)
        self._say(forked=number, pid=pid)

    def _become_worker(self, server: int, connection: int, output: int) -> None:
        """In the new process; does not return."""
        status = 1
        try:
            os.setsid()
            control(_DEATH_SIGNAL, signal.SIGKILL)
            if os.getppid() != server:
                os._exit(1)
            signal.set_wakeup_fd(-1)
            for number in (signal.SIGCHLD, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.SIG_DFL)
            self.selector.close()
            for descriptor in (self.control.fileno(), self.woken, self.wake):
                os.close(descriptor)
            for other in self.forked.values():
                os.close(other.output)
            os.dup2(output, 1)
            os.dup2(output, 2)
            os.close(output)
            sys.stdout = os.fdopen(1, "w", buffering=1, errors="replace", closefd=False)
            sys.stderr = os.fdopen(2, "w", buffering=1, errors="replace", closefd=False)
            faulthandler.enable(2)
            _first_to_go()
            from harness.runner.worker_process import serve

            serve(connection)
            status = 0
        finally:
            os._exit(status)

    def _listen(self, worker: _Forked) -> None:
        data = _drained(worker.output)
        if data is None:
            self.selector.unregister(worker.output)
        else:
            worker.said = (worker.said + data)[-KEPT:]

    def _reap(self) -> None:
        """Workers that ended by themselves."""
        for worker in list(self.forked.values()):
            found, status = os.waitpid(worker.pid, os.WNOHANG)
            if found:
                self._bury(worker, status)

    def _end(self, worker: _Forked) -> None:
        _kill(below(worker.pid) | {worker.pid})
        _, status = os.waitpid(worker.pid, 0)
        self._bury(worker, status)

    def _bury(self, worker: _Forked, status: int) -> None:
        """End what a worker that is gone has left, and say how it went."""
        del self.forked[worker.pid]
        for _ in range(_ROUNDS):
            left = _session(worker.pid) | self._strays()
            if not left:
                break
            _kill(left)
            for pid in left & children(os.getpid()):
                os.waitpid(pid, 0)
        data = _drained(worker.output)
        if data:
            worker.said = (worker.said + data)[-KEPT:]
        if worker.output in self.selector.get_map():
            self.selector.unregister(worker.output)
        os.close(worker.output)
        said = worker.said.decode(errors="replace")
        self._say(ended=worker.number, status=status, said=said)

    def _strays(self) -> set[int]:
        """Processes that workers left to this one, with all below them."""
        found = children(os.getpid()) - set(self.forked)
        return found.union(*(below(pid) for pid in found))


def control(option: int, value: int) -> None:
    """``prctl(2)``; without effect on another system than Linux."""
    call = getattr(ctypes.CDLL(None), "prctl", None)
    if call is not None:
        call(option, value, 0, 0, 0)


def children(pid: int) -> set[int]:
    """Processes that ``pid`` is the parent of, whichever thread started them."""
    return {child for child, (parent, _) in _processes().items() if parent == pid}


def below(pid: int) -> set[int]:
    """Children of ``pid``, theirs, and so on."""
    by_parent: dict[int, list[int]] = {}
    for child, (parent, _) in _processes().items():
        by_parent.setdefault(parent, []).append(child)
    found: set[int] = set()
    open_ = [pid]
    while open_:
        new = set(by_parent.get(open_.pop(), ())) - found
        found |= new
        open_ += new
    return found


def _session(leader: int) -> set[int]:
    return {pid for pid, (_, session) in _processes().items() if session == leader}


def _processes() -> dict[int, tuple[int, int]]:
    """Parent and session of every process that is there; those that are dead and not yet waited
    for by a process of another are left out."""
    found = {}
    for entry in os.listdir("/proc"):
        if not entry.isdigit():
            continue
        try:
            text = Path(f"/proc/{entry}/stat").read_bytes()
        except OSError:
            continue  # it has just ended
        state, parent, _, session = text[text.rindex(b")") + 2 :].split()[:4]
        if state != b"Z" or int(parent) == os.getpid():
            found[int(entry)] = int(parent), int(session)
    return found


def _kill(pids: set[int]) -> None:
    for pid in pids:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


def _drained(file: int) -> bytes | None:
    """What can be read now; None at the end of the file."""
    found = b""
    while True:
        try:
            data = os.read(file, _CHUNK)
        except BlockingIOError:
            return found
        if not data:
            return found or None
        found = (found + data)[-KEPT:]


def _first_to_go() -> None:
    """Where memory runs out, the system ends a worker and not the run."""
    try:
        Path("/proc/self/oom_score_adj").write_text("1000")
    except OSError:
        return  # another system, or not allowed


def main(control_fd: int, path: list[str], device: str) -> None:
    """The process: import, say so, and serve."""
    sys.path[:] = path
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    control(_SUBREAPER, 1)
    parent = socket.socket(fileno=control_fd)
    try:
        from harness.runner import preloaded

        preloaded.load(device)
    except Exception as error:
        parent.send(json.dumps({"failed": f"{type(error).__name__}: {error}"}).encode())
        return
    server = Server(parent)
    parent.send(json.dumps({"ready": True}).encode())
    try:
        server.run()
    finally:
        server.close()
