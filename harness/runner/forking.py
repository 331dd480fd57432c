"""This process's end of fork servers: started once, and used by one run after the other."""

from __future__ import annotations

import json
import os
import pickle
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

from harness.runner.fork_server import LONGEST
from harness.runner.worker_process import Setup

_START = (
    "import sys; sys.path[:] = {path!r}; "
    "from harness.runner.fork_server import main; main({fd}, {path!r}, {device!r})"
)
_IMPORTS, _PATIENCE = 600.0, 60.0
"""Seconds to wait for a server that imports, and for one that has only to answer."""
_idle: dict[str, list[ForkServer]] = {}
"""By device: servers whose run is over."""


class ServerLost(Exception):
    """The fork server is gone, and all its workers with it."""


@dataclass(frozen=True)
class Ended:
    """A worker that is no more: its wait status, and what it printed last."""

    status: int
    said: str


class ForkServer:
    """A fork server of this process."""

    def __init__(self, device: str):
        self.device, self.ended, self.forked = device, dict[int, Ended](), dict[int, int]()
        self._count = 0
        here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with there, tempfile.TemporaryFile() as errors:
            code = _START.format(path=sys.path, fd=there.fileno(), device=device)
            self.process = subprocess.Popen(
                [sys.executable, "-c", code],
                pass_fds=[there.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
            self.errors = os.dup(errors.fileno())
        self.socket, self.is_ready = here, False

    def ready(self) -> None:
        """Wait until it can fork.

        Raises:
            RuntimeError: it could not import what it needs.
        """
        while not self.is_ready:
            self._hear(_IMPORTS)

    def fork(self) -> tuple[int, int, Connection]:
        """A new worker: its number, its process, and the connection to it.

        Raises:
            ServerLost: the server is gone.
        """
        self.ready()
        self._count += 1
        number = self._count
        here, there = socket.socketpair()
        with there:
            try:
                message = json.dumps({"fork": number}).encode()
                socket.send_fds(self.socket, [message], [there.fileno()])
            except OSError:
                raise ServerLost from None
        while number not in self.forked:
            self._hear(_PATIENCE)
        connection = Connection(here.detach())
        setup = Setup(dict(os.environ), os.getcwd(), list(sys.path), self.device)
        with suppress(OSError):  # it ended at once, which its next reader sees
            connection.send_bytes(pickle.dumps(setup))
        return number, self.forked[number], connection

    def end(self, number: int) -> Ended:
        """End a worker with all that it started; how it ended if it had already.

        Raises:
            ServerLost: the server is gone.
        """
        if number not in self.ended:
            try:
                self.socket.send(json.dumps({"end": number}).encode())
            except OSError:
                raise ServerLost from None
            while number not in self.ended:
                self._hear(_PATIENCE)
        self.forked.pop(number, None)
        return self.ended.pop(number)

    def close(self) -> None:
        """End it and its workers."""
        self.socket.close()
        os.close(self.errors)
        try:
            self.process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()  # its workers die with it
            self.process.wait()

    def _hear(self, seconds: float) -> None:
        """The next message, or the end of the server."""
        self.socket.settimeout(seconds)
        try:
            data = self.socket.recv(LONGEST)
        except OSError:  # it was reset, or says nothing: an interrupt may have cost a message
            raise ServerLost from None
        if not data:
            raise ServerLost
        said = json.loads(data)
        if "failed" in said:
            raise RuntimeError(f"a worker process cannot start: {said['failed']}")
        self.is_ready |= "ready" in said
        if "forked" in said:
            self.forked[said["forked"]] = said["pid"]
        if "ended" in said:
            self.ended[said["ended"]] = Ended(said["status"], said["said"])


def take(device: str) -> ForkServer:
    """A server that nobody else of this process uses."""
    servers = _idle.setdefault(device, [])
    while servers:
        server = servers.pop()
        if server.process.poll() is None:
            return server
        server.close()
    return ForkServer(device)


def give(server: ForkServer) -> None:
    """Keep a server, whose workers have ended, for the next run."""
    _idle.setdefault(server.device, []).append(server)
