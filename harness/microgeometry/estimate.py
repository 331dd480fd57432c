"""Monte Carlo estimate of the multi-resolution BTF of a surface (NeuMIP, eq. 1).

.. math:: M(u, \\sigma, \\omega_i, \\omega_o)
          = \\int G(u, \\sigma; x)\\, B(x, \\omega_i, \\omega_o)\\, dx

with the Gaussian footprint G on the reference plane and B the radiance towards the camera
(``wi``) under distant light (from ``wo``) of unit irradiance on that plane. ``B`` of a flat
plane is its BRDF, without cosine.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import columns_of, tensor_of
from harness.microgeometry.tracing import Tracer

LIGHT = 0.01
"""Standard deviation, in radians about each axis, of the smoothed distant light."""

LANES = 1 << 20
"""Paths in flight at a time; bounds the memory whatever the number of queries."""


def reflectance(
    tracer: Tracer,
    u: Tensor,
    kernel: Tensor,
    wi: Tensor,
    wo: Tensor,
    samples: int,
    seed: int,
    depth: int = 3,
    device: str = "cpu",
    light: float = LIGHT,
    lanes: int = LANES,
) -> Tensor:
    """See :func:`harness.microgeometry.queries.truth`, which checks the arguments."""
    n = len(u)
    result = u.new_empty(n, 3, dtype=torch.float32, device=device)
    wide = max(1, min(samples, lanes))
    rows = max(1, lanes // wide)
    for first in range(0, n, rows):
        last = min(n, first + rows)
        part = [
            columns_of(x[first:last].reshape(last - first, -1).to(device))
            for x in (u, kernel, wi, wo)
        ]
        total = torch.zeros(last - first, 3, device=device)
        for done in range(0, samples, wide):
            block = min(wide, samples - done)
            sums = _sum(tracer, part, first, last - first, done, block, seed, depth, light)
            total += tensor_of(*sums, rows=last - first)
        result[first:last] = total / samples
    return result


def _sum(
    tracer: Tracer,
    columns: list[Any],
    first: int,
    rows: int,
    done: int,
    block: int,
    seed: int,
    depth: int,
    light: float,
) -> Any:
    """Sums over ``block`` samples, from number ``done`` on, of ``rows`` queries: Color3f."""
    mi = tracer.mi
    # Opaque numbers: one compiled kernel serves all batches, seeds and depths.
    first_, done_, block_, depth_ = (dr.opaque(mi.UInt32, x) for x in (first, done, block, depth))
    lane = dr.arange(mi.UInt32, rows * block)
    row = lane // block_
    number = lane - row * block_ + done_
    random = _stream(mi, row + first_, number, seed)

    (u, v), (kernel,), (wi_x, wi_y), (wo_x, wo_y) = (
        [dr.gather(mi.Float, c, row) for c in group] for group in columns
    )
    camera = _direction(mi, wi_x, wi_y)
    offset = _normal(mi, random)
    origin = tracer.start(u + kernel * offset.x, v + kernel * offset.y, camera)
    towards = _smoothed(mi, _direction(mi, wo_x, wo_y), light, _normal(mi, random))
    radiance = tracer.radiance(origin, -camera, towards, random, depth_)
    # Unit irradiance on the reference plane is 1 / cos across the beam.
    f = radiance / towards.z
    # Together: a reduction evaluates its argument, and each would trace all paths again.
    dr.eval(f)
    return [dr.block_reduce(dr.ReduceOp.Add, f[k], block) for k in range(3)]


def energy(
    tracer: Tracer,
    u: Tensor,
    kernel: Tensor,
    wi: Tensor,
    samples: int,
    seed: int,
    depth: int = 3,
    device: str = "cpu",
    lanes: int = LANES,
) -> tuple[Tensor, Tensor]:
    r"""Energies [N, 3] reflected towards ``wi`` [N, 2] under constant light, and standard errors.

    .. math:: E(u, \sigma, \omega_i) = \int M(u, \sigma, \omega_i, \omega_o)\,
              d\omega_o^{\perp}

    over the disk: the albedo of a flat plane. Paths choose their way by the BSDF and no light, so
    that ``samples`` of them, 2 or more, know a highlight as well as a matt ground. Light is not
    smoothed, which moves the integral only where f changes within 0.01 radians of the horizon.
    """
    mi = tracer.mi
    n, wide = len(u), max(1, min(samples, lanes))
    rows = max(1, lanes // wide)
    sums = torch.zeros(2, n, 3, dtype=torch.float64, device=device)
    for first in range(0, n, rows):
        last = min(n, first + rows)
        part = [
            columns_of(x[first:last].reshape(last - first, -1).to(device)) for x in (u, kernel, wi)
        ]
        for done in range(0, samples, wide):
            block = min(wide, samples - done)
            lane = dr.arange(mi.UInt32, (last - first) * block)
            row = lane // dr.opaque(mi.UInt32, block)
            number = lane - row * dr.opaque(mi.UInt32, block) + dr.opaque(mi.UInt32, done)
            random = _stream(mi, row + dr.opaque(mi.UInt32, first), number, seed)
            (x, y), (sigma,), (wi_x, wi_y) = (
                [dr.gather(mi.Float, c, row) for c in group] for group in part
            )
            camera, offset = _direction(mi, wi_x, wi_y), _normal(mi, random)
            origin = tracer.start(x + sigma * offset.x, y + sigma * offset.y, camera)
            found = tracer.energy(origin, -camera, random, dr.opaque(mi.UInt32, depth))
            dr.eval(found)
            of_path = tensor_of(*found, rows=len(lane)).double().view(last - first, block, 3)
            sums[0, first:last] += of_path.sum(1)
            sums[1, first:last] += of_path.square().sum(1)
    mean = sums[0] / samples
    # Where all paths agree, rounding may leave less than zero, which has no root.
    variance = (sums[1] / samples - mean.square()).clamp(min=0) / (samples - 1)
    return mean.float(), variance.sqrt().float()


def heights(
    tracer: Tracer, u: Tensor, wi: Tensor, device: str = "cpu", lanes: int = LANES
) -> Tensor:
    """Heights [N] above the reference plane of what ``wi`` [N, 2] sees through ``u`` [N, 2] on it.

    The plane's own, 0, where a ray along a groove ends nowhere (see ``tracing.CROSSINGS``).
    """
    mi = tracer.mi
    parts = []
    for first in range(0, len(u), lanes):
        part = slice(first, first + lanes)
        (x, y), (wi_x, wi_y) = (columns_of(w[part].to(device)) for w in (u, wi))
        camera = _direction(mi, wi_x, wi_y)
        seen = tracer.intersect(mi.Ray3f(tracer.start(x, y, camera), -camera), mi.Mask(True))
        z = dr.select(seen.is_valid(), seen.p.z, 0)
        parts.append(tensor_of(z, rows=len(u[part])).clone())
    return torch.cat(parts)


def _stream(mi: Any, query: Any, sample: Any, seed: int) -> Any:
    """A random stream of its own for each sample of each query, whatever the batch."""
    low, high = mi.sample_tea_32(query, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))
    a, b = mi.sample_tea_32(low ^ sample, high + dr.opaque(mi.UInt32, seed >> 32))
    c, d = mi.sample_tea_32(high ^ sample, low)
    random = mi.PCG32()
    random.seed((mi.UInt64(a) << 32) | mi.UInt64(c), (mi.UInt64(b) << 32) | mi.UInt64(d))
    return random


def _direction(mi: Any, x: Any, y: Any) -> Any:
    return mi.Vector3f(x, y, dr.sqrt(1 - x * x - y * y))


def _normal(mi: Any, random: Any) -> Any:
    """Two standard normal numbers (Box and Muller)."""
    # 1 - u lies in (0, 1], where the logarithm is finite.
    radius = dr.sqrt(-2 * dr.log(1 - random.next_float32()))
    sine, cosine = dr.sincos(dr.two_pi * random.next_float32())
    return mi.Point2f(radius * cosine, radius * sine)


def _smoothed(mi: Any, direction: Any, sigma: float, offset: Any) -> Any:
    """``direction`` moved by ``sigma`` radians times ``offset`` in its tangent plane.

    What falls below the horizon is mirrored up: the smoothed light still brings unit
    irradiance, of which none could arrive from below.
    """
    frame = mi.Frame3f(direction)
    scale = dr.opaque(mi.Float, sigma)
    moved = direction + scale * (offset.x * frame.s + offset.y * frame.t)
    moved = dr.normalize(moved)
    return mi.Vector3f(moved.x, moved.y, dr.abs(moved.z))
