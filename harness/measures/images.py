"""What several image measures share: reference images, and a check of every render."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch

from harness.core.protocol.errors import Unsupported
from harness.core.protocol.method import Method
from harness.measures.base import Job
from harness.rendering.passes import Pass
from harness.rendering.prepared import prepare, prepare_native

KEPT = 2
"""References remembered: all methods of a material come one after the other, and one measure
may have two scenes."""

_references: dict[tuple, tuple[Pass, Any, Any]] = {}


def reference(job: Job, resolution: int, spp: int) -> Pass:
    """A long render of the job's material in its scene, made once per process.

    By Mitsuba's own BSDF with light sampling, so that nothing under test takes part. A
    material or scene that has no such render gets one with cosine sampling.
    """
    key = (id(job.material), id(job.scene), resolution, spp)
    if key not in _references:
        try:
            prepared = prepare_native(job.scene, job.material, resolution)
            # A symbolic call would be compiled with every BSDF alive in it, the one under test
            # included, which is to take no part.
            prepared.symbolic = False
        except Unsupported:
            prepared = prepare(job.scene, job.material, _cosine(job), resolution)
        while len(_references) >= KEPT:
            del _references[next(iter(_references))]
        # With the two objects: as long as they are kept, their ids are not given out again.
        _references[key] = (prepared.render(spp, seed=424242), job.material, job.scene)
    return _references[key][0]


def too_slow(job: Job, resolution: int, spp: int, patience: float) -> str:
    """Why not to begin ``spp`` samples of every pixel, if they cannot end in ``patience`` seconds.

    A brute-force method can need days for an image. Its speed is read off a few samples.
    """
    rows = 1
    while True:
        condition = job.material.conditions(rows, job.generator, job.budget.device)
        u = torch.rand(rows, 3, generator=job.generator).to(condition.device)
        # The first call may compile; of two the shorter tells the speed.
        seconds = min(_seconds(job.method, condition, u) for _ in range(2))
        # Short calls are all overhead: only a long one, or a large one, tells the speed.
        if seconds > 0.1 or rows >= 4096:
            break
        rows *= 8
    needed = seconds / rows * resolution**2 * spp
    if needed <= patience:
        return ""
    return (
        f"{job.method.name} needs about {needed / 3600:.2g} h for {spp} samples in each of"
        f" {resolution} x {resolution} pixels; the limit is {patience:g} s"
    )


def checked(rendered: Pass, job: Job) -> Pass:
    """``rendered``, if every pixel of it is a finite number.

    Raises:
        FloatingPointError: with the number of pixels that are not.
    """
    bad = ~np.isfinite(rendered.rgb).all(-1)
    if bad.any():
        raise FloatingPointError(
            f"{job.method.name} on {job.material.name}: {int(bad.sum())} of {bad.size} pixels"
            " are not finite"
            " (a density that is negative or no number shows as that)"
        )
    return rendered


def _seconds(method: Method, condition: torch.Tensor, u: torch.Tensor) -> float:
    start = time.perf_counter()
    method.sample(condition, u)
    return time.perf_counter() - start


def _cosine(job: Job) -> Any:
    from harness.core import registry

    method = registry.make("cosine")
    method.bind(job.material)
    return method
