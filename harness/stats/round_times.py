"""Times of interleaved rounds, alone and beside those of what they are compared with."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray

from harness.stats.intervals import Interval, median_interval, ratio_of_medians


@dataclass(frozen=True)
class RoundTimes:
    """Seconds of a unit of work in each round [R].

    ``rival`` [R] are those of what this is compared with, in the same rounds; None for what is
    compared with nothing.
    """

    label: str
    seconds: NDArray
    rival: NDArray | None = None

    def median(self) -> Interval:
        """Of the seconds."""
        return median_interval(self.seconds)

    def ratio(self) -> Interval:
        """Median over rounds of this time over the rival's; 1 for one without a rival."""
        if self.rival is None:
            # By definition, not measurement: it would be divided by itself.
            return Interval(1.0, 1.0, 1.0)
        return ratio_of_medians(self.seconds, self.rival)

    def width(self) -> float:
        """Full width of the interval of the ratio, or without a rival of the median, over it."""
        value, low, high = self.median() if self.rival is None else self.ratio()
        return (high - low) / value

    def wide(self, tolerance: float) -> bool:
        """Whether that is more than ``tolerance``, or too few rounds tell no interval."""
        return not self.width() <= tolerance
