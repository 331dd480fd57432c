"""A small panel with two logarithmic axes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.analysis import numbers
from harness.report.figures.ink import Box, Ink
from harness.report.figures.style import FAINT, GRID, HAIR, TICK, TITLE

Range = tuple[float, float]
"""Both ends of an axis, above zero."""

_STEPS = (
    (0.35, (1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)),
    (0.7, (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)),
    (1.5, (1.0, 2.0, 5.0)),
    (2.2, (1.0, 3.0)),
    (math.inf, (1.0,)),
)
"""(decades spanned by an axis, multiples of a power of ten that are labelled below that)."""
_TICK = 0.03
"""Length of a tick in inches."""
_DIGIT = 0.055
"""Width of a digit in inches."""
_DECADES = 5.5


@dataclass(frozen=True)
class LogPanel:
    """A panel in ``box`` that shows the ranges ``x`` and ``y``."""

    box: Box
    x: Range
    y: Range

    def at(self, x: ArrayLike, y: ArrayLike) -> NDArray:
        """Places [P, 2] on the sheet, of values that may be nan or out of range."""
        left, bottom, width, height = self.box
        return np.stack(
            [left + width * _share(x, self.x), bottom + height * _share(y, self.y)], axis=-1
        )

    def inside(self, x: ArrayLike, y: ArrayLike) -> NDArray:
        """The same, moved to the panel's edge where they are out of range."""
        return self.at(np.clip(x, *self.x), np.clip(y, *self.y))

    def frame(
        self, ink: Ink, x_numbers: bool = True, y_numbers: bool = True, most: int = 4
    ) -> None:
        """Axes and grid; numbers along an axis where asked for, ``most`` of them at most.

        Where an axis has many decades they are powers of ten, which are shorter.
        """
        left, bottom, width, height = self.box
        long = max(math.log10(high / low) for low, high in (self.x, self.y)) > _DECADES
        numbered = powers_of_ten if long else tick_label
        edge = np.array([[left, bottom + height], [left, bottom], [left + width, bottom]])
        ink.line(edge, FAINT, HAIR, depth=2)
        taken = -math.inf
        for value in ticks(self.x, most):
            x = left + width * float(_share(value, self.x))
            ink.line(np.array([[x, bottom], [x, bottom + height]]), GRID, HAIR, depth=0.2)
            ink.line(np.array([[x, bottom], [x, bottom - _TICK]]), FAINT, HAIR, depth=2)
            words = numbered(value)
            # A number at an edge stays within the panel, away from the next panel's.
            half = _DIGIT * len(words) / 2
            middle = min(max(x, left + half - 0.03), left + width - half + 0.03)
            if x_numbers and middle - half > taken:
                ink.text(middle, bottom - 2 * _TICK, words, ha="center", va="top", fontsize=TICK)
                taken = middle + half + _DIGIT
        for value in ticks(self.y, most):
            y = bottom + height * float(_share(value, self.y))
            ink.line(np.array([[left, y], [left + width, y]]), GRID, HAIR, depth=0.2)
            ink.line(np.array([[left, y], [left - _TICK, y]]), FAINT, HAIR, depth=2)
            if y_numbers:
                ink.text(left - 2 * _TICK, y, numbered(value), ha="right", fontsize=TICK)

    def title(self, ink: Ink, words: str) -> None:
        """Words above the panel."""
        left, bottom, width, height = self.box
        ink.text(
            left + width / 2, bottom + height + 0.04, words, ha="center", va="bottom",
            fontsize=TITLE,
        )  # fmt: skip

    def guides(self, ink: Ink, slope: float, through: float, colour: str) -> None:
        """Lines of that slope, a decade apart, one of which is at ``through`` where x is one."""
        for factor in 10.0 ** np.arange(-9, 10):
            constant = through * factor
            # Where the line is within the range of y, cut off at that of x.
            ends = np.sort([(y / constant) ** (1 / slope) for y in self.y])
            x = np.clip(ends, *self.x)
            if x[1] > x[0] * 1.001:
                ink.line(self.at(x, constant * x**slope), colour, HAIR, depth=0.5)


def _share(values: ArrayLike, span: Range) -> NDArray:
    low, high = (math.log10(end) for end in span)
    return (np.log10(np.asarray(values, float)) - low) / (high - low)


def ticks(span: Range, most: int = 4) -> list[float]:
    """Round numbers in ``span``: multiples of powers of ten, or powers some decades apart."""
    low, high = span
    decades = math.log10(high / low)
    first = next(i for i, (widest, _) in enumerate(_STEPS) if decades < widest)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    found: list[float] = []
    for _, steps in _STEPS[first:]:
        found = [s * 10.0**p for p in powers for s in steps if low <= s * 10.0**p <= high]
        if len(found) <= most:
            break
    # Coarser steps may leave next to none: then the ends of what the finer ones gave.
    if len(found) < 2:
        steps = _STEPS[first][1]
        found = [s * 10.0**p for p in powers for s in steps if low <= s * 10.0**p <= high]
        found = found if len(found) <= most else [found[0], found[len(found) // 2], found[-1]]
    stride = -(-len(found) // most)
    return found[::stride] if stride else []


def tick_label(value: float) -> str:
    """A tick's number: as it is, or as a digit times a power of ten."""
    if 1e-3 <= value < 1e4:
        return f"{value:g}"
    # Ticks are single digits times a power of ten, or 1.5 of them.
    power = math.floor(math.log10(value) + 1e-9)
    digit = value / 10.0**power
    return numbers.plain(value, -power if math.isclose(digit, round(digit)) else 1 - power)


def powers_of_ten(value: float) -> str:
    """10 to its power, in superscript digits; another number as :func:`tick_label` has it."""
    if not math.isclose(math.log10(value) % 1 % 0.999999, 0, abs_tol=1e-6):
        return tick_label(value)
    power = str(round(math.log10(value))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"10{power}"


def around(values: NDArray, by: float) -> Range:
    """The range of finite, positive ``values``, wider by the factor ``by`` at both ends."""
    good = values[np.isfinite(values) & (values > 0)]
    return float(good.min()) / by, float(good.max()) * by
