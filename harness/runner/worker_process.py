"""A worker process: carries out the tasks that come over its connection, until it is ended.

It has a session of its own, its output goes to the fork server, and it writes no file of the run.
What it sends are pickles: ``("begun",)`` once the machine is free for a task, ``("note", TEXT)``,
and ``("done", ANSWER)``.
"""

from __future__ import annotations

import os
import pickle
import sys
import tempfile
import traceback
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from harness.core.registry import oneline
from harness.measures.base import Outcome
from harness.runner.global_state import WORKER
from harness.runner.task import Answer, Task


@dataclass(frozen=True)
class Setup:
    """What a worker takes over from the driver of the run."""

    environment: dict[str, str]
    folder: str
    path: list[str]
    device: str


def serve(descriptor: int) -> None:
    """Carry out tasks until the other end is closed."""
    connection = Connection(descriptor)
    setup: Setup = pickle.loads(connection.recv_bytes())
    os.environ.clear()
    os.environ.update(setup.environment | {WORKER: str(os.getpid())})
    if os.path.isdir(setup.folder):
        os.chdir(setup.folder)
    sys.path[:] = setup.path
    tempfile.tempdir = None  # the environment says it

    def say(*what: Any) -> None:
        connection.send_bytes(pickle.dumps(what, protocol=5))

    try:
        from harness.runner.preflight import ready

        ready(setup.device)
        from harness.runner.carry_out import Carrier

        carrier = Carrier(lambda text: say("note", text))
        while True:
            task: Task = pickle.loads(connection.recv_bytes())
            try:
                answer = carrier.do(task, lambda: say("begun"))
            except BaseException as error:  # KeyboardInterrupt too: nobody else can raise it here
                answer = _broken(task, error)
            try:
                data = pickle.dumps(("done", answer), protocol=5)
            except Exception as error:
                data = pickle.dumps(("done", _broken(task, error)), protocol=5)
            connection.send_bytes(data)
    except (EOFError, ConnectionError):
        return  # the driver is gone


def _broken(task: Task, error: BaseException) -> Answer:
    failed = Outcome("error", oneline(error), traceback=traceback.format_exc())
    # What raised here was not looked at afterwards.
    return Answer([replace(failed) for _ in task.trials], findings=["ends its job with an error"])
