"""Does a material reflect anything at all? Asked of materials under test: others may be black."""

from __future__ import annotations

import torch

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material

CONDITIONS, DIRECTIONS = 256, 16
LEAST = 1e-16
"""Of the largest value met: squares of less are no numbers of single precision any more."""


def check(material: Material) -> None:
    """Refuse a material that is black, or as good as, wherever it was asked.

    At random conditions, in random directions and around the mirrored one, where lobes are.
    """
    generator = torch.Generator().manual_seed(23)
    condition = material.conditions(CONDITIONS, generator)
    wo = square_to_disk(torch.rand(CONDITIONS, DIRECTIONS, 2, generator=generator))
    near = 1e-3 * torch.randn(CONDITIONS, DIRECTIONS // 2, 2, generator=generator)
    wo[:, ::2] = 0.999 * (near - condition[:, None, -2:])
    largest = float(material.target_grid(condition, wo.to(condition)).max())
    where = f"material '{material.name}'"
    if largest == 0:
        raise InputError(f"{where}: reflects nothing: its BSDF is zero wherever it was asked")
    if largest < LEAST:
        raise InputError(
            f"{where}: reflects next to nothing: its BSDF is {largest:.0e} at most, and single"
            " precision has no numbers for squares of that"
        )
