"""Materials, methods and jobs for tests of the measures."""

from __future__ import annotations

import math
import time
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.measures import registry as measures
from harness.measures.base import Job, Outcome
from harness.scenes import registry as scenes
from tests.materials import Plain
from tests.measuring import run

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


# --- pdf -------------------------------------------------------------------------------


def pdf(method: Method, material: Material) -> dict[str, float]:
    """The measure at a size for tests."""
    return values(measured("pdf", method, material, conditions=16, resolution=32, samples=1024))
