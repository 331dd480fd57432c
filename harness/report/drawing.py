"""Draws the figures of a report, on all cores where that is safe."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn
from harness.report.parts import parts

_THREADED = ("torch", "drjit")
"""Once these are loaded they run threads, which a forked process would lack."""


def draw(
    results: Results, names: Sequence[str], folder: Path, notify: Callable[[str], None]
) -> dict[str, list[Drawn] | str]:
    """Figures by name, in ``folder``; of one that cannot be drawn the reason.

    ``notify`` is told each name before it is waited for.
    """
    workers = min(len(names), len(os.sched_getaffinity(0)))
    if workers < 2 or any(library in sys.modules for library in _THREADED):
        return {name: _one(results, name, folder) for name in names if _told(notify, name)}
    # Results are inherited: to read or to pickle them would take longer than some figures.
    context = multiprocessing.get_context("fork")
    # Figures are many small objects and soon gone: collecting garbage among them takes a tenth.
    with ProcessPoolExecutor(workers, context, initializer=gc.disable) as pool:
        begun = {name: pool.submit(_one, results, name, folder) for name in names}
        return {name: figures.result() for name, figures in begun.items() if _told(notify, name)}


def _one(results: Results, name: str, folder: Path) -> list[Drawn] | str:
    figure: Callable[[Results, Canvas], Any] = parts("figures")[name].load()
    canvas = Canvas(folder)
    found = figure(results, canvas)
    return found if isinstance(found, str) else canvas.drawn


def _told(notify: Callable[[str], None], name: str) -> bool:
    notify(f"figure {name}")
    return True
