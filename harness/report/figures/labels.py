"""Labels beside points, none over another, over a marker or out of the panel."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox

_ANGLES = tuple(math.radians(a) for a in range(15, 375, 15))
_REACH = (7, 11, 16, 22, 29, 37, 46, 56, 68, 82, 98)
"""Distances in points at which a place is looked for, the nearest first."""
_LEADER = 12
"""From this distance on a thin line leads to the point."""
_MARKER = 4.0
"""Half the side of a marker's box, in points."""


@dataclass(frozen=True)
class Label:
    """``text`` for the point ``(x, y)`` in the panel's data coordinates."""

    x: float
    y: float
    text: str
    colour: str


def place(
    panel: Axes,
    labels: Sequence[Label],
    points: Sequence[tuple[float, float]],
    lines: Sequence[tuple[float, float]] = (),
    taken: Sequence[Bbox] = (),
    size: float = 6.0,
    within: tuple[float, float, float, float] | None = None,
) -> list[Label]:
    """Write ``labels``; those for which there is no room are given back.

    They stay in the panel, or in the box ``within`` (left, bottom, width, height; in data
    coordinates). ``points`` are the markers to keep clear of, ``taken`` boxes in pixels. If it can
    be had, a label also keeps clear of the line through ``lines``, and is nearer to its own point
    than to any other label's; else a thin line leads to its point. The figure must have its final
    layout.
    """
    renderer = FigureCanvasAgg(panel.figure).get_renderer()
    pixel = panel.figure.dpi / 72  # per point
    to_pixels = panel.transData.transform
    inside = panel.get_window_extent(renderer)
    if within is not None:
        left, bottom, width, height = within
        inside = Bbox([to_pixels((left, bottom)), to_pixels((left + width, bottom + height))])
    boxes = [*taken, *(_around(to_pixels(p), _MARKER * pixel) for p in points)]
    along = _dots([to_pixels(p) for p in lines], pixel)
    anchors = [to_pixels((item.x, item.y)) for item in labels]
    left_over = []
    for k in sorted(range(len(labels)), key=lambda i: labels[i].x):
        label, at = labels[k], anchors[k]
        probe = panel.text(0, 0, label.text, fontsize=size, linespacing=1.0)
        extent = probe.get_window_extent(renderer)
        probe.remove()
        spots = [
            spot
            for spot in _spots(at, extent.width, extent.height, pixel)
            if _within(spot[0], inside) and not any(spot[0].overlaps(other) for other in boxes)
        ]
        others = [a for i, a in enumerate(anchors) if i != k]
        good = (
            spot
            for spot in spots
            if not any(spot[0].contains(*dot) for dot in along)
            and all(_gap(spot[0], at) < 0.7 * _gap(spot[0], other) for other in others)
        )
        best = next(good, None)
        leader = best is None or best[1] >= _LEADER
        if not spots:
            left_over.append(label)
            continue
        box = (best or spots[0])[0]
        boxes.append(box.padded(1.5))
        offset = ((box.x0 + box.x1) / 2 - at[0], (box.y0 + box.y1) / 2 - at[1])
        arrow = {"arrowstyle": "-", "lw": 0.4, "color": label.colour, "shrinkA": 0.5, "shrinkB": 2}
        note = panel.annotate(
            label.text,
            (label.x, label.y),
            xytext=(offset[0] / pixel, offset[1] / pixel),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=size,
            linespacing=1.0,
            color=label.colour,
            zorder=5,
            arrowprops=arrow if leader else None,
            path_effects=[withStroke(linewidth=1.5, foreground="white", alpha=0.8)],
        )
        note.set_in_layout(False)
    return left_over


def _spots(
    at: tuple[float, float], width: float, height: float, pixel: float
) -> Iterator[tuple[Bbox, float]]:
    """Boxes of that size around a point, the nearest first, and their distance in points."""
    for reach in _REACH:
        for angle in _ANGLES:
            cos, sin = math.cos(angle), math.sin(angle)
            # Measured to the edge that faces the point, so that long labels may start beside it.
            x = at[0] + reach * pixel * cos + math.copysign(min(1, abs(cos) * 2), cos) * width / 2
            y = at[1] + reach * pixel * sin + math.copysign(min(1, abs(sin) * 2), sin) * height / 2
            yield Bbox.from_bounds(x - width / 2, y - height / 2, width, height), reach


def _within(box: Bbox, frame: Bbox) -> bool:
    return box.x0 >= frame.x0 and box.x1 <= frame.x1 and box.y0 >= frame.y0 and box.y1 <= frame.y1


def _gap(box: Bbox, at: tuple[float, float]) -> float:
    """Distance of a point from a box, in pixels."""
    return math.hypot(
        max(box.x0 - at[0], 0, at[0] - box.x1), max(box.y0 - at[1], 0, at[1] - box.y1)
    )


def _dots(corners: Sequence[tuple[float, float]], pixel: float) -> list[tuple[float, float]]:
    """Points along a line through ``corners``, closer than a line of text is high."""
    dots = []
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        count = max(1, math.ceil(math.hypot(x1 - x0, y1 - y0) / (3 * pixel)))
        dots += [(x0 + (x1 - x0) * i / count, y0 + (y1 - y0) * i / count) for i in range(count)]
    return dots


def _around(at: tuple[float, float], half: float) -> Bbox:
    return Bbox.from_bounds(at[0] - half, at[1] - half, 2 * half, 2 * half)
