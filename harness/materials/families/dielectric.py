"""One passage of light at a rough dielectric interface (Walter et al. 2007), over Dr.Jit arrays.

GGX microfacets, isotropic, with Smith's masking as a product of the two directions', which is
what Mitsuba's ``roughdielectric`` and Guo et al. (2018) use. Light that a second microfacet would
catch is lost. Directions are seen from the side that the light comes from, which is up.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr

from harness.core.columns.bridge import Float
from harness.materials.families import ggx


class Passage(NamedTuple):
    """A microfacet chosen for a direction: its reflectance, and where light goes from it.

    ``mirrored`` and ``refracted`` point away from the surface; above the horizon
    (``mirrored``) or below (``refracted``) they are valid, else the light is lost. They have the
    weights :func:`masking` when chosen with probabilities ``reflectance`` and one minus it.
    """

    reflectance: Float
    mirrored: Any
    refracted: Any


def fresnel(cos: Float, eta: Float) -> tuple[Float, Float]:
    """Unpolarised reflectance, and the refracted ray's cosine (zero in total reflection).

    ``eta``: index of refraction on the far side over that on the near side.
    """
    # 1 - sin_t^2, where sin_t = sin / eta; below zero there is no refracted ray.
    squared = 1 - (1 - cos * cos) / (eta * eta)
    cos_t = dr.sqrt(dr.maximum(squared, 0))
    s = (cos - eta * cos_t) / (cos + eta * cos_t)
    p = (eta * cos - cos_t) / (eta * cos + cos_t)
    return dr.select(squared > 0, 0.5 * (s * s + p * p), 1), cos_t


def pass_through(w: Any, alpha: ggx.Roughness, eta: Float, u1: Float, u2: Float) -> Passage:
    """What happens to light from ``w`` at a visible microfacet; two uniforms."""
    m = ggx.sample_visible(w, alpha, u1, u2)
    cos = dr.dot(w, m)
    reflectance, cos_t = fresnel(cos, eta)
    return Passage(reflectance, 2 * cos * m - w, (cos / eta - cos_t) * m - w / eta)


def masking(cos: Float, alpha: Float) -> Float:
    """Smith's G1 of a direction at a cosine from the normal, on either side."""
    cos = dr.abs(cos)
    return 2 * cos / (cos + dr.sqrt(cos * cos + alpha * alpha * (1 - cos * cos)))
