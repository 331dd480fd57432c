"""From fields to what a BSDF reads: masks, colours, normals, bitmaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.textures.noise import Field


def smoothstep(low: float, high: float, x: Field) -> Field:
    """Cubic step from 0 at ``low`` to 1 at ``high`` (which may be the smaller of the two)."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def unit_range(x: Field) -> Field:
    """``x`` moved and scaled to span [0, 1]."""
    return (x - x.min()) / (x.max() - x.min())


def colour(code: str) -> NDArray[np.float64]:
    """Linear Rec. 709 colour [3] of an sRGB code such as ``"#8a5a3b"``."""
    srgb = np.array([int(code[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def mix(a: Any, b: Any, t: Field) -> NDArray[np.float64]:
    """``a`` where ``t`` is 0, ``b`` where it is 1; fields, numbers or colours [3] / [..., 3]."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    if any(x.shape == (3,) or x.ndim == t.ndim + 1 for x in (a, b)):
        t = t[..., None]
    return a * (1 - t) + b * t


def ramp(t: Field, stops: Sequence[tuple[float, str]]) -> NDArray[np.float64]:
    """Colour ramp: ``t`` [...] through ``stops`` (position, sRGB code) -> linear [..., 3]."""
    at = [position for position, _ in stops]
    colours = np.stack([colour(code) for _, code in stops])
    return np.stack([np.interp(t, at, colours[:, k]) for k in range(3)], -1)


def normals(height: Field, strength: float) -> NDArray[np.float64]:
    """Unit normals [size, size, 3] of a height field that wraps around.

    ``strength`` is height, in widths of the tile, of one unit of ``height``. Central
    differences; the normal of z = h(u, v) is ``(-dh/du, -dh/dv, 1)``, normalised.
    """
    size = height.shape[0]
    scale = strength * size / 2
    du = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) * scale
    dv = (np.roll(height, -1, 0) - np.roll(height, 1, 0)) * scale
    n = np.stack([-du, -dv, np.ones_like(du)], -1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def bitmap(values: Any) -> dict[str, Any]:
    """A texture dictionary of linear ``values`` [H, W] or [H, W, C], as MitsubaMaterial reads it.

    Raises:
        ValueError: a value outside [0, 1], which would not be a reflectance.
    """
    array = np.asarray(values, np.float32)
    array = array[..., None] if array.ndim == 2 else array
    if not (array.min() >= 0 and array.max() <= 1):
        raise ValueError(f"texture outside [0, 1]: {array.min()} to {array.max()}")
    return {
        "type": "bitmap",
        "array": np.ascontiguousarray(array),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": "repeat",
    }


def normal_map(height: Field, strength: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    """``bsdf`` seen through the normals of ``height`` (see :func:`normals`)."""
    return {
        "type": "normalmap",
        "normalmap": bitmap((normals(height, strength) + 1) / 2),
        "bsdf": bsdf,
    }


def anisotropic_alpha(alpha: Field, ratio: Field | float) -> tuple[Field, Field]:
    """``(alpha_u, alpha_v)`` of product ``alpha**2`` and quotient ``ratio``."""
    root = np.sqrt(ratio)
    return alpha * root, alpha / root
