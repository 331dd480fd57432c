"""Rendering in passes of moments, with Mitsuba's own integrators."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from harness.stats.moments import one_sample_variance

_renders = 0

LANES = 1 << 18
"""Camera rays per pass: large enough to amortise a launch, small enough for the cache."""


@dataclass(frozen=True)
class Pass:
    """One finished render: moments over ``spp`` independent samples of every pixel.

    ``rgb`` [H, W, 3] mean radiance; ``mean`` [H, W] mean luminance; ``variance`` [H, W]
    unbiased estimate of the variance of ONE luminance sample, nan for ``spp`` = 1;
    ``seconds`` wall time.
    """

    rgb: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    spp: int
    seconds: float

    def error(self, mask: np.ndarray) -> float:
        """Variance of one sample, averaged over the pixels of ``mask`` [H, W]."""
        return float(self.variance[mask].mean())


@contextlib.contextmanager
def evaluated_mode() -> Iterator[None]:
    """Have Dr.Jit run loops and BSDF calls one after the other instead of as one kernel.

    A torch method needs it. Column methods would do without, but measured three to seven
    times slower inside a symbolic call, which keeps network activations on the stack.
    """
    flags = (dr.JitFlag.SymbolicCalls, dr.JitFlag.SymbolicLoops)
    before = [dr.flag(f) for f in flags]
    for f in flags:
        dr.set_flag(f, False)
    try:
        yield
    finally:
        for f, value in zip(flags, before, strict=True):
            dr.set_flag(f, value)


def rendering() -> bool:
    """Whether :func:`render` is at work."""
    return _renders > 0


def render(
    scene: mi.Scene, integrator: mi.Integrator, spp: int, seed: int, symbolic: bool = False
) -> Pass:
    """``spp`` samples per pixel from a ``moment`` integrator.

    Split into passes of at most :data:`LANES` rays; pass k of seed s draws from its own
    stream, so renders of different seeds are independent. Finished when it returns.

    Raises:
        KeyboardInterrupt: the user interrupted the render.
    """
    global _renders
    film = scene.sensors()[0].film().crop_size()
    size = min(spp, max(1, LANES // int(film[0] * film[1])))
    start = time.perf_counter()
    total: np.ndarray | None = None
    with contextlib.nullcontext() if symbolic else evaluated_mode():
        for k, first in enumerate(range(0, spp, size)):
            count = min(size, spp - first)
            # Mitsuba mixes seed and lane into its streams: any distinct integers will do.
            # Not mi.render: it wraps an interrupt, among other things, in a RuntimeError.
            stream = (seed * 4099 + k) % (1 << 32)
            _renders += 1
            try:
                image = integrator.render(scene, scene.sensors()[0], seed=stream, spp=count)
                dr.eval(image)
            finally:
                _renders -= 1
            dr.sync_thread()
            if integrator.should_stop():
                # Mitsuba catches the signal while it renders, and returns half an image.
                raise KeyboardInterrupt
            part = np.asarray(image, dtype=np.float64) * count
            total = part if total is None else total + part
    seconds = time.perf_counter() - start
    moments = total / spp
    mean = moments[..., 4]
    if spp == 1:
        variance = np.full_like(mean, np.nan)
    else:
        # Where the image is infinite, inf - inf: its variance is nan, and that is no news.
        with np.errstate(invalid="ignore"):
            variance = one_sample_variance(mean, moments[..., 7], spp)
    return Pass(moments[..., :3], mean, variance, spp, seconds)


def coverage(scene: mi.Scene, bsdf: mi.BSDF, samples: int = 64, seed: int = 0) -> np.ndarray:
    """Bool [H, W]: pixels that show nothing but ``bsdf`` in ``samples`` random rays each."""
    sensor = scene.sensors()[0]
    width, height = (int(v) for v in sensor.film().crop_size())
    pixel = dr.repeat(dr.arange(mi.UInt32, width * height), samples)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, width * height * samples)
    jitter = sampler.next_2d()
    position = mi.Point2f(
        (mi.Float(pixel % width) + jitter.x) / width, (mi.Float(pixel // width) + jitter.y) / height
    )
    ray, _ = sensor.sample_ray(0.0, sampler.next_1d(), position, sampler.next_2d())
    si = scene.ray_intersect(ray)
    seen = mi.Mask(True) if getattr(bsdf, "both_sides", False) else si.wi.z > 0
    hit = si.is_valid() & (si.bsdf() == mi.BSDFPtr(bsdf)) & seen
    count = dr.block_reduce(dr.ReduceOp.Add, dr.select(hit, mi.UInt32(1), 0), samples)
    return (count.numpy() == samples).reshape(height, width)
