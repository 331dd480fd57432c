"""The figures of a report as tasks, of which the longest are shared out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import Any

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn
from harness.report.figures.fonts import family
from harness.report.parts import parts

_SHARED = ("convergence", "tradeoff", "pareto", "images")
"""Figures that take longest, of which two canvases draw every other."""

Found = list[Drawn] | str
"""Figures, or why there are none."""


def tasks(results: Results, names: Sequence[str], folder: Path) -> dict[str, Callable[[], Found]]:
    """What draws the figures ``names`` into ``folder``, by what it is called; the longest first."""
    _prepare()
    made: dict[str, Callable[[], Found]] = {}
    for name in sorted(names, key=lambda name: name not in _SHARED):
        shares = 2 if name in _SHARED else 1
        for i in range(shares):
            task = partial(_draw, results, name, Canvas(folder, share=(i, shares)))
            made[_called(name, i, shares)] = task
    return made


def collected(made: Mapping[str, Any], names: Sequence[str]) -> dict[str, Found]:
    """By name, in the order of ``names``, what :func:`tasks` gave."""
    found: dict[str, Found] = {}
    for name in names:
        shares = 2 if name in _SHARED else 1
        of_it = [made[_called(name, i, shares)] for i in range(shares)]
        drawn = [one for one in of_it if not isinstance(one, str)]
        in_turn = [figure for turn in zip_longest(*drawn) for figure in turn if figure is not None]
        found[name] = in_turn if drawn else of_it[0]
    return found


def _called(name: str, share: int, shares: int) -> str:
    return f"figure {name}" + (f", part {share + 1} of {shares}" if shares > 1 else "")


def _prepare() -> None:
    """Import what every figure takes, and make its fonts: once, before there are processes."""
    for module in ("backends.backend_pdf", "backends.backend_agg"):
        import_module(f"matplotlib.{module}")
    import_module("fontTools.subset")
    family()


def _draw(results: Results, name: str, canvas: Canvas) -> Found:
    found = parts("figures")[name].load()(results, canvas)
    return found if isinstance(found, str) else canvas.drawn
