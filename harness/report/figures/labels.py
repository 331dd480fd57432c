"""Labels beside points, none over another, over a marker or out of the panel."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

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
    boxes = np.array([box.extents for box in taken] or np.empty((0, 4)))
    boxes = np.concatenate([boxes, [_around(to_pixels(p), _MARKER * pixel) for p in points]])
    along = np.array(_dots([to_pixels(p) for p in lines], pixel)).reshape(-1, 2)
    anchors = np.array([to_pixels((item.x, item.y)) for item in labels]).reshape(-1, 2)
    left_over = []
    for k in sorted(range(len(labels)), key=lambda i: labels[i].x):
        label, at = labels[k], anchors[k]
        probe = panel.text(0, 0, label.text, fontsize=size, linespacing=1.0)
        extent = probe.get_window_extent(renderer)
        probe.remove()
        spots, reach = _spots(at, extent.width, extent.height, pixel)
        free = _within(spots, inside.extents) & ~_overlap(spots, boxes).any(1)
        spots, reach = spots[free], reach[free]
        if not len(spots):
            left_over.append(label)
            continue
        others = np.delete(anchors, k, axis=0)
        good = ~_overlap(spots, np.tile(along, 2)).any(1)
        good &= (_gaps(spots, at[None]) < 0.7 * _gaps(spots, others)).all(1)
        best = int(good.argmax())  # the first of the good ones, or of all
        leader = not good.any() or reach[best] >= _LEADER
        box = Bbox.from_extents(*spots[best])
        boxes = np.concatenate([boxes, [box.padded(1.5).extents]])
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


def _spots(at: NDArray, width: float, height: float, pixel: float) -> tuple[NDArray, NDArray]:
    """Boxes [S, 4] of that size around a point, the nearest first, and their distances [S] in
    points."""
    reach = np.repeat(_REACH, len(_ANGLES))
    cos, sin = (np.tile(f(_ANGLES), len(_REACH)) for f in (np.cos, np.sin))
    # Measured to the edge that faces the point, so that long labels may start beside it.
    x = at[0] + reach * pixel * cos + np.copysign(np.minimum(1, 2 * abs(cos)), cos) * width / 2
    y = at[1] + reach * pixel * sin + np.copysign(np.minimum(1, 2 * abs(sin)), sin) * height / 2
    half = np.array([-width, -height, width, height]) / 2
    return np.stack([x, y, x, y], 1) + half, reach


def _within(boxes: NDArray, frame: NDArray) -> NDArray:
    return (boxes[:, :2] >= frame[:2]).all(1) & (boxes[:, 2:] <= frame[2:]).all(1)


def _overlap(boxes: NDArray, others: NDArray) -> NDArray:
    """Which boxes [S, 4] touch which others [O, 4], points among them: [S, O]."""
    a, b = boxes[:, None], others[None]
    return (a[..., :2] <= b[..., 2:]).all(-1) & (b[..., :2] <= a[..., 2:]).all(-1)


def _gaps(boxes: NDArray, points: NDArray) -> NDArray:
    """Distances of points [P, 2] from boxes [S, 4], in pixels: [S, P]."""
    a, p = boxes[:, None], points[None]
    return np.linalg.norm(np.maximum(np.maximum(a[..., :2] - p, p - a[..., 2:]), 0), axis=-1)


def _dots(corners: Sequence[tuple[float, float]], pixel: float) -> list[tuple[float, float]]:
    """Points along a line through ``corners``, closer than a line of text is high."""
    dots = []
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        count = max(1, math.ceil(math.hypot(x1 - x0, y1 - y0) / (3 * pixel)))
        dots += [(x0 + (x1 - x0) * i / count, y0 + (y1 - y0) * i / count) for i in range(count)]
    return dots


def _around(at: tuple[float, float], half: float) -> list[float]:
    return [at[0] - half, at[1] - half, at[0] + half, at[1] + half]
