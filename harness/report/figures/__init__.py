"""The figures, by the names a suite uses.

Each takes results and a :class:`~harness.report.figures.canvas.Canvas` to save on, and gives
what was drawn, or a sentence saying why nothing was.
"""

from __future__ import annotations

from collections.abc import Callable

from harness.analysis.results import Results
from harness.report.figures.breakeven import breakeven
from harness.report.figures.canvas import Canvas, Drawn
from harness.report.figures.convergence import convergence
from harness.report.figures.effects import effects
from harness.report.figures.heatmap import heatmap
from harness.report.figures.images import images
from harness.report.figures.importance_maps import importance_maps
from harness.report.figures.materials import materials
from harness.report.figures.pareto import pareto
from harness.report.figures.slices import slices
from harness.report.figures.tradeoff import tradeoff

FIGURES: dict[str, Callable[[Results, Canvas], list[Drawn] | str]] = {
    "materials": materials,
    "tradeoff": tradeoff,
    "pareto": pareto,
    "breakeven": breakeven,
    "convergence": convergence,
    "slices": slices,
    "images": images,
    "heatmap": heatmap,
    "importance-maps": importance_maps,
    "effects": effects,
}

__all__ = ["FIGURES", "Canvas", "Drawn"]
