"""Random generators whose whole seed counts."""

from __future__ import annotations

import hashlib

import torch


def generator(seed: int) -> torch.Generator:
    """A generator on the CPU for ``seed``, of any size: another for any other.

    ``torch.Generator().manual_seed`` keeps the low 32 bits of what it is given and says nothing:
    ``1 << 40`` draws what ``0`` draws.
    """
    digest = hashlib.sha256(str(seed).encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:4], "big"))
