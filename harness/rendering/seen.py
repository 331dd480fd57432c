"""Conditions of the points that pixels show, as a render has them.

Import this module after ``variant.use``: a Mitsuba class belongs to a variant.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from numpy.typing import NDArray

from harness.core.columns.bridge import tensor_of
from harness.rendering.plugin import SampledBSDF
from harness.rendering.prepared import Prepared


def conditions(prepared: Prepared, pixels: NDArray, within: NDArray, seed: int) -> torch.Tensor:
    """A condition [P, C] of the point ``within`` [P, 2] (x, y in [0, 1)) of each of ``pixels``
    [P, 2] (row, column).

    The scene's filter is a box: every point of a pixel counts alike. Pixels are to show nothing
    but the material (:attr:`Prepared.mask`). ``seed`` is of what else a camera draws.
    """
    placed = prepared.bsdf
    assert isinstance(placed, SampledBSDF)
    sensor = prepared.scene.sensors()[0]
    width, height = (int(v) for v in sensor.film().crop_size())
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(pixels))
    # Column with x, row with y.
    x, y = (
        mi.Float(np.ascontiguousarray(pixels[:, 1 - k] + within[:, k], np.float32)) for k in (0, 1)
    )
    at = mi.Point2f(x / width, y / height)
    ray, _ = sensor.sample_ray_differential(0.0, sampler.next_1d(), at, sampler.next_2d())
    si = prepared.scene.ray_intersect(ray)
    facing, _ = placed.facing(si)
    columns = placed._condition(facing)
    dr.eval(columns)
    return tensor_of(*columns, rows=len(pixels))
