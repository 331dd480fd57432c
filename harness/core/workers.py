"""Independent parts of reading results on all cores, where that is safe."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from typing import Any

_THREADED = ("torch", "drjit")
"""Once these are loaded they run threads, which a forked process would lack."""
_tasks: dict[str, Callable[[], Any]] = {}
"""Those of the pool at work. Its processes inherit them: to pickle the results that they are about
would take longer than some of them."""


def together(
    tasks: Mapping[str, Callable[[], Any]], notify: Callable[[str], None] = lambda name: None
) -> dict[str, Any]:
    """What each of ``tasks`` gives, by its name; the longest should come first.

    ``notify`` is told each name before it is waited for. What a task raises is raised.
    """
    workers = min(len(tasks), len(os.sched_getaffinity(0)))
    if workers < 2 or not _may_fork():
        return {name: task() for name, task in tasks.items() if _told(notify, name)}
    _tasks.update(tasks)
    try:
        context = multiprocessing.get_context("fork")
        with ProcessPoolExecutor(workers, context, initializer=_begin) as pool:
            begun = {name: pool.submit(_run, name) for name in tasks}
            return {name: one.result() for name, one in begun.items() if _told(notify, name)}
    finally:
        _tasks.clear()


def _may_fork() -> bool:
    """Whether this process runs no thread that a forked one would lack, and may have children."""
    threaded = any(library in sys.modules for library in _THREADED)
    return not (
        threaded or threading.active_count() > 1 or multiprocessing.current_process().daemon
    )


def _begin() -> None:
    # Figures are many small objects and soon gone: collecting garbage among them takes a tenth.
    gc.disable()
    gc.freeze()


def _run(name: str) -> Any:
    return _tasks[name]()


def _told(notify: Callable[[str], None], name: str) -> bool:
    notify(name)
    return True
