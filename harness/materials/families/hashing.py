"""Random numbers that depend on nothing but the numbers they are asked for.

A value estimated by random walks has to be a *function* of condition and direction: asked
twice, in whatever batch, it gives the same. So each lane's generator starts from a hash of
the bits of its inputs.
"""

from __future__ import annotations

import importlib
from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns


def generator_at(columns: Columns, seed: int) -> Any:
    """A PCG32 per lane, seeded by the bits of ``columns`` and ``seed``."""
    unsigned = dr.uint32_array_t(type(columns[0]))
    # Opaque, so that another seed finds the kernel compiled.
    a = dr.opaque(unsigned, _low(seed) ^ 0x9E3779B9)
    b = dr.opaque(unsigned, _low(seed >> 32) ^ 0x85EBCA6B)
    for column in columns:
        # -0 and 0 are equal and have to give the same numbers.
        bits = dr.reinterpret_array(unsigned, dr.select(column == 0, 0, column))
        a = _mix(a ^ bits)
        b = _mix(b + bits * 0x9E3779B1 + a)
    wide = dr.uint64_array_t(type(columns[0]))
    state, sequence = wide(a) << 32 | wide(b), wide(_mix(a + 0x27D4EB2F))
    # Not by the constructor, which would add each lane's index to its state.
    generator = importlib.import_module(type(columns[0]).__module__).PCG32()
    generator.seed(state, sequence)
    return generator


def exponential(rng: Any) -> Any:
    """One exponentially distributed number of mean one per lane, never zero.

    From the centres of the 2^23 intervals, so that no logarithm is zero or infinite.
    """
    return -dr.log(rng.next_float32() + 2.0**-24)


def _mix(x: Any) -> Any:
    """A bijection of 32 bits in which every input bit reaches every output bit.

    Two rounds of multiplication and shifted exclusive or, with constants of C. Wellons.
    """
    x = (x ^ (x >> 16)) * 0x7FEB352D
    x = (x ^ (x >> 15)) * 0x846CA68B
    return x ^ (x >> 16)


def _low(seed: int) -> int:
    return seed & 0xFFFFFFFF
