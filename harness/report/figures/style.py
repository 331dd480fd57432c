"""The look of all print figures: fonts, lines, widths of a page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl

from harness.report.figures.fonts import family

PAGE = 7.0
"""Inches: both columns of a page. A figure this wide is printed as large as it is drawn."""
TALL = 9.3
"""Inches: most that a figure is high, with its caption below on A4 or letter."""
TITLE, LABEL, TICK = 8.0, 7.0, 6.0
"""Points: names of panels, of axes and methods, numbers along axes."""
INK, FAINT, GRID = "#333333", "#777777", "#e2e2e2"
"""Colours of words, of what stands back, and of grids."""
HAIR, THIN, LINE = 0.4, 0.7, 1.0
"""Points: widths of grids and frames, of intervals, of curves."""

_RC = {
    "font.family": "sans-serif",
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 8.0,
    "axes.titley": 1.0,  # where it is: not looked for above all that the axes have
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#555555",
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "pdf.fonttype": 42,  # TrueType, so that the text of a PDF can be edited and searched
    "svg.hashsalt": "harness",
    "text.parse_math": False,  # a name may have dollars in it
}


@contextmanager
def styled() -> Iterator[None]:
    """The look of all figures, for as long as the context lasts."""
    with mpl.rc_context(_RC | {"font.sans-serif": family()}):
        yield
