"""Methods and materials whose numbers are known beforehand, and their jobs."""

from __future__ import annotations

import math
import time
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.fitting.targets import cells
from harness.measures import registry as measures
from harness.measures.base import Job, Outcome
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from tests.materials import Plain
from tests.measuring import run
from tests.planted import Correct

variant.use("cpu")

SCENE = scenes.make("uniform-sphere")


class Still(Plain):
    """A bump that stays where it is, whatever ``wi``: every condition has the same p*."""

    name = "still"

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        return super().eval(torch.full_like(condition, 0.25), wo)


class Uneven(Method):
    """Constant on each half of the disk: ``share / pi`` for x >= 0, ``(2 - share) / pi`` below.

    Against a uniform p*, with s the share, KL = -(ln s + ln(2 - s)) / 2 and
    chi-square = (1 / s + 1 / (2 - s)) / 2 - 1. ``lost`` of the samples are invalid.
    """

    name = "uneven"

    def __init__(self, share: float = 1.0, lost: float = 0.0):
        self.share, self.lost = share, lost

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        turn = math.pi * (u[:, 1] - 0.5)
        wo = 0.999999 * u[:, :1].sqrt() * torch.stack([turn.cos(), turn.sin()], -1)
        # Stretched to [0, 1) over the valid samples.
        pick = (u[:, 2] - self.lost) / (1 - self.lost)
        right = pick < self.share / 2
        wo = torch.where(right[:, None], wo, wo * torch.tensor([-1.0, 1.0]))
        wo = torch.where(pick[:, None] < 0, torch.tensor([2.0, 0.0]), wo)
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        half = torch.where(wo[:, 0] > 0, self.share, 2 - self.share)
        return torch.where(inside_disk(wo), (1 - self.lost) * half / math.pi, 0)


class Exact(Uneven):
    """The density of :class:`Still`, for what needs no samples of it."""

    name = "exact"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        total = Still().target_grid(condition[:1], cells(256)[None]).mean() * math.pi
        return Still().target(condition, wo) / total


class TooLarge(Correct):
    """Its density is ten per cent too large, so its images are too dark."""

    name = "too-large"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return 1.1 * super().pdf(condition, wo)


class Rare(Uneven):
    """Right, but three samples in a hundred thousand carry a tenth of the light."""

    name = "rare"
    outside, rare = 0.1, 3e-5

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        inside = 1 - self.outside
        low = torch.where(u[:, 2] < self.rare, inside, 0)
        width = torch.where(u[:, 2] < self.rare, self.outside, inside)
        r, turn = (low + width * u[:, 0]).sqrt(), 2 * math.pi * u[:, 1]
        wo = 0.999999 * r[:, None] * torch.stack([turn.cos(), turn.sin()], -1)
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        inside = wo.square().sum(-1) < 0.999999**2 * (1 - self.outside)
        times = torch.where(inside, (1 - self.rare) / (1 - self.outside), self.rare / self.outside)
        return times * super().pdf(condition, wo)


class Sleepy(Uneven):
    """As good as :class:`Uneven`, but slow."""

    name = "sleepy"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        time.sleep(0.06)
        return super().sample(condition, u)


class Nan(Uneven):
    """Without a density."""

    name = "nan"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return super().pdf(condition, wo) * math.nan


class Glacial(Uneven):
    """0.15 s a row, and not to be asked for an image."""

    name = "glacial"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        if len(condition) > 1:
            raise AssertionError("was asked for an image")
        time.sleep(0.15)
        return super().sample(condition, u)


def job(
    measure: str, method: Method, material: Material, baseline: bool = False, **given: Any
) -> Job:
    """One trial's job, as the runner makes it."""
    own = torch.Generator().manual_seed(0)
    method.fit(material, Budget(), own)
    return Job(
        trial=None,
        material=material,
        method=method,
        scene=SCENE if measures.load(measure).needs_scene else None,
        seed=0,
        generator=torch.Generator().manual_seed(0),
        settings=measures.settings(measure, given),
        budget=Budget(),
        make=lambda: type(method)(),
        baseline=baseline,
    )


def measured(name: str, method: Method, material: Material, **given: Any) -> Outcome:
    """Of one method."""
    return run(name, [job(name, method, material, **given)])[0]


def values(outcome: Outcome) -> dict[str, float]:
    """By metric."""
    assert outcome.status == "ok"
    found = {r.metric: r.value for r in outcome.records}
    assert len(found) == len(outcome.records)
    for r in outcome.records:
        assert not r.ci_low > r.value and not r.ci_high < r.value
    return found


def assert_same_bytes(*outcomes: Outcome, names: tuple[str, ...]) -> None:
    """What is the same for all methods is stored once: the arrays have the same bytes."""
    for name in names:
        first, *others = (o.arrays[name] for o in outcomes)
        for other in others:
            assert (other.dtype, other.tobytes()) == (first.dtype, first.tobytes()), name
