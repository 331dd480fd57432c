"""Densities as measures ask for them: every one of them is looked at, not a sample of rows.

A density below zero, or infinite, is none. Guards that leave out samples of density zero would
leave such a row out as well, and its numbers would look fine.
"""

from __future__ import annotations

import torch
from torch import Tensor

from harness.core.protocol.method import Method


def checked_density(pdf: Tensor, method: Method, what: str = "pdf") -> Tensor:
    """``pdf`` of any shape, if all of it is finite and not negative.

    Raises:
        FloatingPointError: with the number of rows that are not.
    """
    bad = ~((pdf >= 0) & (pdf < torch.inf))
    if bool(bad.any()):
        raise FloatingPointError(
            f"{method.name}: {what} is negative or not finite in {int(bad.sum())} of"
            f" {bad.numel()} rows"
        )
    return pdf
