"""What pictures of densities say below themselves."""

from __future__ import annotations

BELOW_ZERO = (
    "A divergence below zero is no divergence: over the grid's cells the pdf, as the method gives "
    "it, sums to more than one, since a peak is taken at the centre of its cell"
)
