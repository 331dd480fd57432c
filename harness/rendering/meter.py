"""Where the time of a render goes, and how often the renderer asks for what."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar

import drjit as dr
import torch

from harness.core.protocol import counting

PARTS = ("sample", "pdf", "eval")
"""What a BSDF does: the method's sampler, its density, the material's reflectance."""

COUNTS = (
    "bounces",
    "rays",
    "shadow-rays",
    "evaluations",
    "values",
    "pdf-queries",
    "light-queries",
    "network",
)
"""What is counted over all surfaces of a scene, see :class:`Meter`."""

_ROWS = {"sample": "samples", "pdf": "pdf-queries", "eval": "evaluations"}

Result = TypeVar("Result")


@dataclass
class Tally:
    """Of one part: how often it was called, on how many active rows, and its seconds."""

    calls: int = 0
    rows: int = 0
    seconds: float = 0.0


@dataclass
class Meter:
    """Counts and times what a :class:`~harness.rendering.plugin.SampledBSDF` is asked for.

    Inputs are forced before the clock starts, so that nothing else's work is counted, and
    results before it stops. That splits kernels which Dr.Jit would fuse: a metered render
    takes longer than a bare one, and its image is the same. The feature lookup of a condition
    counts where it happens, in sampling. ``points`` are the rows that hit the material, on
    either side, and ``directions`` those of them that a ray goes on from: a valid sample that
    does not reflect nothing.
    """

    parts: dict[str, Tally] = field(default_factory=lambda: {part: Tally() for part in PARTS})
    points: int = 0
    directions: int = 0
    counts: Counter[str] = field(default_factory=Counter)

    def during(self, part: str, active: Any, inputs: Any, work: Callable[[], Result]) -> Result:
        """``work()``, its time and active rows added to ``part``."""
        if _traced():
            return work()
        rows = _count(active)
        dr.eval(inputs, active)
        _finish()
        start = time.perf_counter()
        result = work()
        dr.eval(result)
        _finish()
        tally = self.parts[part]
        tally.seconds += time.perf_counter() - start
        tally.calls += 1
        tally.rows += rows
        self.counts[_ROWS[part]] += rows
        return result

    def sampled(self, hit: Any, value: Any) -> None:
        """A call of ``BSDF.sample`` gave ``value`` on the rows ``hit`` of the tested material."""
        points, directions = self.bounced(hit, value)
        self.points += points
        self.directions += directions

    def bounced(self, hit: Any, value: Any) -> tuple[int, int]:
        """A call of any ``BSDF.sample`` gave ``value`` on the rows ``hit``: (rows, that go on)."""
        found = _count(hit), _count(hit & dr.any(value != 0))
        self.counts["bounces"] += found[0]
        self.counts["rays"] += found[1]
        return found

    def add(self, what: str, active: Any, times: int = 1) -> None:
        """``times`` the active rows to a count."""
        self.counts[what] += times * _count(active)


@contextlib.contextmanager
def metered(bsdf: Any) -> Iterator[Meter]:
    """A meter on a ``SampledBSDF`` while the block runs."""
    bsdf.meter = Meter()
    try:
        with counting.into(bsdf.meter.counts):
            yield bsdf.meter
    finally:
        bsdf.meter = None


def _count(mask: Any) -> int:
    return 0 if _traced() else int(dr.count(mask)[0])


def _traced() -> bool:
    """Whether a symbolic kernel is being traced, which has no rows yet.

    Only of another render: a metered one runs call by call. Dr.Jit traces all BSDFs and lights
    alive, whether or not they are in the scene that is rendered.
    """
    return bool(dr.flag(dr.JitFlag.SymbolicScope))


def _finish() -> None:
    dr.sync_thread()
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
