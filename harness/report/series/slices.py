"""What tables and pictures of densities say of divergences below zero."""

from __future__ import annotations

BELOW_ZERO = (
    "A divergence below zero is no divergence: over the grid's cells the pdf, as the method gives "
    "it, sums to more than one, since a peak is taken at the centre of its cell"
)
REACHES_BELOW = (
    "the interval reaches below zero, where no divergence is: conditions differ by more than a "
    "mean of so many tells"
)
