"""Small multiples: panels of one size in rows, a legend below all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from harness.report.figures.log_panel import tick_label, ticks

_LEFT, _RIGHT, _ABOVE, _BELOW = 0.6, 0.12, 0.28, 0.48
"""Inches around a panel's axes: labels of its y axis, air, its title, labels of its x axis."""
_INNER = 0.42
"""Inches left of a panel that has tick labels there and no axis label."""
_X_LABEL, _Y_LABEL = 0.25, 0.42
"""Inches from the axes to their labels."""
_LINE = 0.2
"""Inches that a line of the legend takes."""
_NARROWEST = 4.6
"""Inches of a figure: two columns of a legend with the longest labels."""


@dataclass(frozen=True)
class Labels:
    """What is written around one panel; without a title it stands closer to the one above."""

    x: str
    y: str
    title: str = ""
    emphasised: bool = False
    """Whether the title is set in italics."""


def panels(
    columns_of: Sequence[Sequence[Labels]],
    size: tuple[float, float],
    handles: Sequence[Artist],
    widest: int = 4,
    handle_length: float = 2.0,
) -> tuple[Figure, list[list[Axes]]]:
    """A figure of panels whose axes are ``size`` inches, and these, in the order of ``columns_of``.

    Each of ``columns_of`` is a stack of panels that stay below each other; stacks stand in
    rows. Only the first of a row has the label of its y axis. All measures are given: to have
    matplotlib find them from the texts takes as long as drawing. ``widest`` is the most in a row.
    """
    width, height = size
    per_row = -(-len(columns_of) // -(-len(columns_of) // widest))
    rows = -(-len(columns_of) // per_row)
    stack = [_ABOVE * bool(labels.title) + height + _BELOW for labels in columns_of[0]]
    legend_columns = min(len(handles), max(2, round(1.5 * per_row)))
    legend = _LINE * -(-len(handles) // legend_columns) + 0.1
    step = _INNER + width + _RIGHT
    inside = _LEFT - _INNER + per_row * step
    total = max(inside, _NARROWEST), rows * sum(stack) + legend
    figure = Figure(figsize=total)
    found = []
    for i, labels_of in enumerate(columns_of):
        row, column = divmod(i, per_row)
        left = (total[0] - inside) / 2 + _LEFT + column * step
        top = total[1] - row * sum(stack)
        made = []
        for labels, tall in zip(labels_of, stack, strict=True):
            top -= tall
            box = (left / total[0], (top + _BELOW) / total[1], width / total[0], height / total[1])
            made.append(_panel(figure, box, size, labels, first=column == 0))
        found.append(made)
    figure.legend(
        handles=list(handles), loc="lower center", ncols=legend_columns, handlelength=handle_length
    )
    return figure, found


def log_ticks(panel: Axes) -> None:
    """Labels where a logarithmic axis needs them: decades, or between where it spans less."""
    for axis in (panel.xaxis, panel.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(FixedLocator(ticks((low, high), 5)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: tick_label(value)))
        # Between its labels a small panel has none: they would take longer than all its lines.
        axis.set_minor_locator(NullLocator())


def _panel(
    figure: Figure,
    box: tuple[float, float, float, float],
    size: tuple[float, float],
    labels: Labels,
    first: bool,
) -> Axes:
    panel = figure.add_axes(box)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.grid(True, which="major")
    panel.set_title(labels.title, style="italic" if labels.emphasised else "normal")
    panel.set_xlabel(labels.x)
    panel.xaxis.set_label_coords(0.5, -_X_LABEL / size[1])
    if first:
        panel.set_ylabel(labels.y)
        panel.yaxis.set_label_coords(-_Y_LABEL / size[0], 0.5)
    return panel
