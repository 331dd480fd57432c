r"""GGX microsurfaces with Smith's statistics, over Dr.Jit arrays.

Directions are ``Array3f`` of unit length in the local frame. With the stretched length

.. math:: a(\omega) = \sqrt{z^2 + \alpha_x^2 x^2 + \alpha_y^2 y^2}

every quantity has a form that holds for directions above and below the horizon and on it:
the projected area of the microfacets is :math:`\sigma = (z + a)/2` and Smith's
:math:`\Lambda = (a - z)/(2z)` (Heitz et al. 2016, sections 4 and 5.2).
"""

from __future__ import annotations

import importlib
import math
from typing import Any, NamedTuple

import drjit as dr

from harness.core.columns.bridge import Columns, Float

Vector = Any
"""``drjit.llvm.ad.Array3f`` or its CUDA counterpart."""


class Roughness(NamedTuple):
    """GGX's alpha along x and along y."""

    x: Float
    y: Float


def vector(x: Float, y: Float, z: Float) -> Vector:
    """Three columns as one array of vectors."""
    return importlib.import_module(type(x).__module__).Array3f(x, y, z)


def above(x: Float, y: Float) -> Vector:
    """The direction over a point of the disk; on the horizon for points on or off the rim."""
    # Rounding puts points of the rim a little outside; no direction is lost by it.
    return vector(x, y, dr.sqrt(dr.maximum(1 - x * x - y * y, 0)))


def on_disk(w: Vector, valid: Any) -> tuple[Float, Float]:
    """The point of the disk below ``w``; (2, 0), off the disk, where it is not valid.

    Rounding puts directions of less than some 3e-4 above the horizon on the rim, where there
    is none; light at grazing incidence leaves there. They are drawn in by 2.4e-7.
    """
    squared = w.x * w.x + w.y * w.y
    scale = dr.select(squared < 1 - 2.0**-23, 1, (1 - 2.0**-22) * dr.rsqrt(squared))
    return dr.select(valid, scale * w.x, 2), dr.select(valid, scale * w.y, 0)


def spread(w: Vector, alpha: Roughness) -> Float:
    """:math:`\\alpha_x^2 x^2 + \\alpha_y^2 y^2`."""
    return dr.square(alpha.x * w.x) + dr.square(alpha.y * w.y)


def stretched(w: Vector, alpha: Roughness) -> Float:
    """a of the module's docstring."""
    return dr.sqrt(w.z * w.z + spread(w, alpha))


def projected_area(w: Vector, alpha: Roughness) -> Float:
    """Sigma: area of the microfacets as seen from ``w``, per area of the surface."""
    t = spread(w, alpha)
    a = dr.sqrt(w.z * w.z + t)
    # Two forms of one number; each is free of cancellation on its side of the horizon.
    return 0.5 * dr.select(w.z > 0, a + w.z, t / (a - w.z))


def smith(w: Vector, alpha: Roughness) -> Float:
    """Lambda of a direction above the horizon, positive; infinite on the horizon."""
    t = spread(w, alpha)
    return 0.5 * t / (w.z * (dr.sqrt(w.z * w.z + t) + w.z))


def inverse_smith(w: Vector, alpha: Roughness) -> Float:
    """1 / Lambda: positive above the horizon, negative below, zero on it."""
    t = spread(w, alpha)
    a = dr.sqrt(w.z * w.z + t)
    return 2 * w.z * dr.select(w.z > 0, (a + w.z) / t, 1 / (a - w.z))


def ndf(m: Vector, alpha: Roughness) -> Float:
    """Density of microfacet normals D, per steradian and area of the surface."""
    s = dr.square(m.x / alpha.x) + dr.square(m.y / alpha.y) + m.z * m.z
    return dr.select(m.z > 0, 1 / (math.pi * alpha.x * alpha.y * s * s), 0)


def sample_visible(w: Vector, alpha: Roughness, u1: Float, u2: Float) -> Vector:
    r"""A microfacet normal as seen from ``w``, of density :math:`\max(0, w\cdot m) D(m)/\sigma(w)`.

    In the space where the surface is a hemisphere, mirrored directions are uniform on the
    spherical cap of :math:`z > -w_z` (Dupuy and Benyoub 2023). That holds for ``w`` below the
    horizon too. Uses two uniforms.
    """
    s = dr.normalize(vector(alpha.x * w.x, alpha.y * w.y, w.z))
    sin, cos = dr.sincos(2 * math.pi * u1)
    # z of the cap's point is hz - s.z; its sine from (1 - z)(1 + z), each without cancellation.
    hz = (1 - u2) * (1 + s.z)
    r = dr.sqrt(u2 * (1 + s.z) * (1 - s.z + hz))
    return dr.normalize(vector(alpha.x * (r * cos + s.x), alpha.y * (r * sin + s.y), hz))


def mirrored(w: Vector, m: Vector) -> Vector:
    """``w`` mirrored about the normal ``m``; both point away from the surface."""
    return 2 * dr.dot(w, m) * m - w


def schlick(r0: Float, cos: Float) -> Float:
    """Schlick's approximation of the Fresnel reflectance of a conductor."""
    # A cosine is above one by rounding alone.
    x = dr.maximum(1 - cos, 0)
    x2 = x * x
    return r0 + (1 - r0) * (x2 * x2 * x)


def sample_mixture(wi: Vector, alpha: Roughness, even: Float, u: Columns) -> tuple[Float, Float]:
    """A cosine lobe with probability ``even``, else ``wi`` mirrored at a visible normal.

    A point of the disk from three uniforms; (2, 0), off the disk, for a mirrored direction
    below the horizon.
    """
    w = mirrored(wi, sample_visible(wi, alpha, u[1], u[2]))
    radius = dr.sqrt(u[1])
    sin, cos = dr.sincos(2 * math.pi * u[2])
    lobe, up = u[0] >= even, w.z > 0
    x = dr.select(lobe, dr.select(up, w.x, 2), radius * cos)
    y = dr.select(lobe, dr.select(up, w.y, 0), radius * sin)
    return x, y


def pdf_mixture(wi: Vector, alpha: Roughness, even: Float, wo: Columns) -> Float:
    """Density of :func:`sample_mixture` per disk area."""
    inside = wo[0] * wo[0] + wo[1] * wo[1] < 1
    out = above(dr.select(inside, wo[0], 0), dr.select(inside, wo[1], 0))
    h = dr.normalize(wi + out)
    lobe = ndf(h, alpha) / (4 * projected_area(wi, alpha) * out.z)
    return dr.select(inside, dr.lerp(lobe, 1 / math.pi, even), 0)
