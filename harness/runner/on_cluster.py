"""What runs in a Dask worker: its tasks in worker processes of ours, its files from their content.

A Dask worker's own process and threads run nothing of a method.
"""

from __future__ import annotations

import pickle
import shutil
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from distributed import Worker, WorkerPlugin, get_worker

from harness.runner.carried_files import CarriedFiles
from harness.runner.limits import Limits
from harness.runner.local import Local
from harness.runner.task import Answer, Task

_locals: dict[tuple[int, str, str], Local] = {}
"""By thread, device and limits."""


class Files(WorkerPlugin):
    """Files of a run, on every worker that there is or will be."""

    def __init__(self, files: CarriedFiles):
        self.files, self.name = files, f"harness-files-{files.digest}"
        self.folder = Path()

    def setup(self, worker: Worker) -> None:
        """Unpack them."""
        self.folder = Path(tempfile.mkdtemp(prefix="harness-files-"))
        self.files.unpack(self.folder)

    def teardown(self, worker: Worker) -> None:
        """Remove them."""
        shutil.rmtree(self.folder, ignore_errors=True)


def carried_out(task: bytes, plugin: str, device: str, limits: Limits) -> bytes:
    """The answer to a task, both pickled; gives up when nobody waits for it any more."""
    worker = get_worker()
    files: Files = worker.plugins[plugin]
    moved = files.files.moved(pickle.loads(task), files.folder)
    return pickle.dumps(_answer(moved, device, limits, _is_wanted(worker)), protocol=5)


def _answer(task: Task, device: str, limits: Limits, wanted: Callable[[], bool]) -> Answer:
    key = threading.get_ident(), device, repr(limits)
    if key not in _locals:
        slots = max(1, get_worker().state.nthreads)
        _locals[key] = Local(lambda text: None, device, 1, limits, share=slots)
    local = _locals[key]
    local.submit(0, task)
    while True:
        for _, answer in local.wait():
            return answer
        if not wanted():
            local.__exit__()
            del _locals[key]
            return Answer(died="nobody waits for it any more")


def _is_wanted(worker: Worker) -> Callable[[], bool]:
    key = worker.get_current_task()

    def wanted() -> bool:
        task: Any = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return wanted


def rest() -> None:
    """End idle worker processes: the run is over."""
    for local in list(_locals.values()):
        local.rest()


def machine(device: str) -> dict[str, Any]:
    """What this worker's machine is, and its name."""
    import platform

    from harness.core.machine import identity

    return {"identity": identity(device), "host": platform.node()}
