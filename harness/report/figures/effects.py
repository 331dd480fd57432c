"""A scene as it is and without each of its effects, and where that shows."""

from __future__ import annotations

from matplotlib.axes import Axes
from numpy.typing import NDArray

from harness.analysis.effects import MEASURE, Rows, effects_of, trials, verdict
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet
from harness.report.figures.rendered import exposure, srgb
from harness.report.figures.style import styled

ORDER = 100
_CELL, _LABEL, _UNDER = 1.9, 0.2, 0.3
"""Inches: width of a picture, heights of its label and of the words below."""
_ACROSS = 5
_INK = {"needed": "#1b1d21", "negligible": "#777777", "missing": "#b34700", "not needed": "#777777"}


def effects(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene, material and method."""
    drawn = []
    with styled():
        for (scene, material, method), rows in trials(results).items():
            stored = [
                results.stored(t).images
                for t in results.trials(MEASURE, material, method, scene)[:1]
            ]
            if rows and stored and "full" in stored[0]:
                drawn.append(_figure(canvas, (scene, material, method), rows, stored[0]))
    return drawn or f"no trial of the measure {MEASURE} stored an image"


def _figure(
    canvas: Canvas, names: tuple[str, str, str], rows: Rows, images: dict[str, NDArray]
) -> Drawn:
    scene, material, method = names
    full = images["full"]
    shown = [name for name in effects_of(rows) if name in images]
    scale = exposure(full)
    tall = _CELL * full.shape[0] / full.shape[1]
    across = min(1 + len(shown), _ACROSS)
    lines = -(-(1 + len(shown)) // across)
    line = _LABEL + 2 * tall + _UNDER
    figure, axes = sheet(across * _CELL, lines * line)
    for i, name in enumerate(["", *shown]):
        row, column = divmod(i, across)
        place = (column * _CELL, (lines - row) * line - _LABEL)
        _panel(axes, place, tall, images, rows, name, scale)
    return canvas.save(
        figure,
        f"effects-{scene}-{material}-{method}",
        f"Effects of {scene}, {material}",
        f"{material} in the scene {scene}, sampled by {method}: as called for, and without each "
        "effect that it calls for (or with one that it does not). Below each: FLIP's map of the "
        "change (black none, yellow a third and more), what it adds to the time of a sample per "
        "pixel, and the verdict.",
    )


def _panel(
    axes: Axes,
    place: tuple[float, float],
    tall: float,
    images: dict[str, NDArray],
    rows: Rows,
    name: str,
    scale: float,
) -> None:
    x, top = place
    gap, middle = 0.02, x + _CELL / 2
    word = verdict(rows, name) if name else ""
    title = "as called for" if not name else f"with {name}" if word in _LACKED else f"no {name}"
    axes.text(middle, top + 0.03, title, ha="center", va="bottom", fontsize=8)
    box = (x + gap, top - tall + gap, _CELL - 2 * gap, tall - 2 * gap)
    picture(axes, srgb(images[name or "full"], scale), box)
    seconds = rows["seconds-per-spp"]["value"]
    if not name:
        said = f"{1e3 * seconds:.3g} ms/spp"
    else:
        below = (x + gap, top - 2 * tall + gap, _CELL - 2 * gap, tall - 2 * gap)
        change = images[f"{name}.flip"][..., 0]
        picture(axes, change, below, cmap="inferno", vmin=0, vmax=0.33)
        adds = rows[f"{name}.seconds"]["value"]
        said = f"{1e3 * adds:+.2g} ms/spp ({adds / seconds:+.0%})\n{word}"
    axes.text(
        middle, top - 2 * tall - 0.01 if name else top - tall - 0.01, said,
        ha="center", va="top", fontsize=6.5, linespacing=1.2, color=_INK.get(word, "#1b1d21"),
    )  # fmt: skip


_LACKED = ("missing", "not needed")
