r"""Real spherical harmonics to the fourth degree, of a direction (x, y, z), as polynomials.

One for every degree l <= 4 and order -l <= m <= l, in that order: 25. Orthonormal over the sphere.
They are arithmetic alone, so that torch tensors and Dr.Jit columns go through the same lines.
"""

from __future__ import annotations

import math
from typing import TypeVar

V = TypeVar("V")

COUNT = 25


def harmonics(x: V, y: V, z: V) -> list[V]:
    """The 25 values at unit vectors; the first, a constant, as a value like the others."""
    xx, yy, zz = x * x, y * y, z * z
    pi = math.pi
    a = math.sqrt(3 / (4 * pi))
    b = math.sqrt(15 / (4 * pi))
    found = [0 * z + 0.5 / math.sqrt(pi), a * y, a * z, a * x]
    found += [b * (x * y), b * (y * z), math.sqrt(5 / (16 * pi)) * (3 * zz - 1), b * (x * z)]
    found += [0.5 * b * (xx - yy)]
    c, d, e = math.sqrt(35 / (32 * pi)), math.sqrt(105 / (4 * pi)), math.sqrt(21 / (32 * pi))
    found += [c * (y * (3 * xx - yy)), d * (x * y * z), e * (y * (5 * zz - 1))]
    found += [math.sqrt(7 / (16 * pi)) * (z * (5 * zz - 3)), e * (x * (5 * zz - 1))]
    found += [0.5 * d * (z * (xx - yy)), c * (x * (xx - 3 * yy))]
    f, g = math.sqrt(35 / pi), math.sqrt(35 / (2 * pi))
    h, i = math.sqrt(5 / pi), math.sqrt(5 / (2 * pi))
    found += [0.75 * f * (x * y * (xx - yy)), 0.75 * g * (y * z * (3 * xx - yy))]
    found += [0.75 * h * (x * y * (7 * zz - 1)), 0.75 * i * (y * z * (7 * zz - 3))]
    found += [3 / 16 / math.sqrt(pi) * (zz * (35 * zz - 30) + 3)]
    found += [0.75 * i * (x * z * (7 * zz - 3)), 0.375 * h * ((xx - yy) * (7 * zz - 1))]
    found += [0.75 * g * (x * z * (xx - 3 * yy))]
    found += [3 / 16 * f * (xx * (xx - 3 * yy) - yy * (3 * xx - yy))]
    return found
