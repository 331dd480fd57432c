"""A small material with a correct adapter, and adapters that are each wrong in one way.

They keep ``harness check`` honest: a wrong one must fail the property that is there to
find it, the correct one must pass.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, FitReport, Method


class Plaster(Material):
    """Diffuse, with a broad lobe around the mirrored direction."""

    name = "plaster"

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """0.3/pi and a Gaussian bump, grey."""
        bump = torch.exp(-0.5 * ((wo + condition[:, -2:]) / 0.2).square().sum(-1))
        value = torch.where(inside_disk(wo), 0.3 / math.pi + bump, 0)
        return value[:, None].expand(-1, 3)

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return {"type": "plaster"}


class Soot(Plaster):
    """Plaster, half of which is black: one feature says so."""

    name = "soot"
    n_features = 1

    def places(self, uv: Tensor) -> Tensor:
        """0 on the black half, 1 on the other."""
        return (uv[:, :1] > 0.5).to(uv.dtype)

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Exactly 0 on the black half."""
        return super().eval(condition, wo) * condition[:, :1]


class Correct(Method):
    """A uniform disk and two Gaussian lobes: one at the mirrored direction, a narrow one of 1 %."""

    name = "correct"
    weights = (0.4, 0.59, 0.01)
    sigmas = (0.15, 0.02)

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """Nothing but one number of state, for saving and loading."""
        self.bind(material)
        self.stretch = torch.tensor([0.9])
        return FitReport()

    def state_dict(self) -> dict[str, Tensor]:
        """See :meth:`Method.state_dict`."""
        return {"stretch": self.stretch}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """See :meth:`Method.load_state_dict`."""
        self.stretch = state["stretch"]

    def centres(self, condition: Tensor) -> Tensor:
        """Of the two lobes, [N, 2 lobes, 2]."""
        wi = condition[:, -2:]
        return torch.stack([-self.stretch * wi, wi.flip(-1) * 0.5], 1)

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        condition, u = condition.float(), u.float()
        wo = self.draw(condition, u)
        return DiskSample(wo, self.pdf(condition, wo))

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = weights) -> Tensor:
        """Directions [N, 2], a lobe chosen by the first uniform in proportion to ``share``."""
        first = u[:, 0] < share[0]
        second = ~first & (u[:, 0] < share[0] + share[1])
        turn = 2 * math.pi * u[:, 2]
        circle = torch.stack([turn.cos(), turn.sin()], -1)
        radius = (-2 * torch.log1p(-u[:, 1])).sqrt()
        sigma = torch.where(second, self.sigmas[0], self.sigmas[1])
        centres = self.centres(condition)
        centre = torch.where(second[:, None], centres[:, 0], centres[:, 1])
        lobe = centre + (sigma * radius)[:, None] * circle
        return torch.where(first[:, None], self.radius(u[:, 1])[:, None] * circle, lobe)

    def radius(self, u: Tensor) -> Tensor:
        """Of a uniform point of the disk."""
        return u.sqrt()

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        condition, wo = condition.float(), wo.float()
        density = torch.where(inside_disk(wo), self.weights[0] / math.pi, 0)
        off = wo[:, None] - self.centres(condition)
        for k, sigma in enumerate(self.sigmas):
            norm = self.weights[k + 1] / (2 * math.pi * sigma**2)
            density = density + norm * torch.exp(-0.5 * (off[:, k] / sigma).square().sum(-1))
        return density


class Bare(Correct):
    """Correct, and without the uniform share: its density falls to 1e-30 inside the disk."""

    name = "bare"
    weights = (0.0, 0.99, 0.01)
    sigmas = (0.17, 0.02)

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = weights) -> Tensor:
        """Directions [N, 2]."""
        return super().draw(condition, u, share)


class PdfTooLarge(Correct):
    """Its density is 3 % too large."""

    name = "pdf-too-large"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return 1.03 * super().pdf(condition, wo)


class ForgetsJacobian(Correct):
    """Samples the disk uniformly in radius, with the density of uniform in area."""

    name = "forgets-jacobian"

    def radius(self, u: Tensor) -> Tensor:
        """Without the square root."""
        return u


class MissesLobe(Correct):
    """Never draws the lobe of 1 % that its density has."""

    name = "misses-lobe"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo = self.draw(condition, u, (0.4 / 0.99, 1.0, 0.0))
        return DiskSample(wo, self.pdf(condition, wo))


class HalfDisk(Correct):
    """Samples its own density correctly, but that is zero on half of the disk."""

    name = "half-disk"

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = ()) -> Tensor:
        """Uniform on x >= 0."""
        turn = math.pi * (u[:, 2] - 0.5)
        return u[:, 1:2].sqrt() * torch.stack([turn.cos(), turn.sin()], -1)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        # cos(-pi/2) in single precision is -4e-8.
        return torch.where(inside_disk(wo) & (wo[:, 0] > -1e-7), 2 / math.pi, 0)


class WrongReportedPdf(Correct):
    """Reports the density of the chosen lobe alone with a sample."""

    name = "wrong-reported-pdf"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, pdf = super().sample(condition, u)
        return DiskSample(wo, torch.where(u[:, 0] < self.weights[0], 0.4 / math.pi, pdf))


class MutatesInputs(Correct):
    """Turns ``wi`` around in the caller's memory."""

    name = "mutates-inputs"

    def centres(self, condition: Tensor) -> Tensor:
        """Of the lobes, in place."""
        wi = condition[:, -2:].neg_()
        return torch.stack([self.stretch * wi, -wi.flip(-1) * 0.5], 1)


class IgnoresU(Correct):
    """Draws random numbers of its own."""

    name = "ignores-u"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        return super().sample(condition, torch.rand(u.shape))


class ClampsToRim(Correct):
    """Pushes samples that leave the disk to just inside its rim."""

    name = "clamps-to-rim"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo = self.draw(condition, u)
        wo = wo / (wo.norm(dim=-1, keepdim=True) / 0.999).clamp(min=1)
        return DiskSample(wo, self.pdf(condition, wo))


class SpreadsNan(Correct):
    """Normalises by the largest value of the batch, so that one nan reaches every row."""

    name = "spreads-nan"

    def centres(self, condition: Tensor) -> Tensor:
        """Of the lobes, times 1, or times nan."""
        return super().centres(condition) * (1 + 0 * condition.sum())


class DependsOnRows(Correct):
    """The first row of every batch is treated differently (one frame for a whole batch)."""

    name = "depends-on-rows"

    def centres(self, condition: Tensor) -> Tensor:
        """Of the lobes, turned around where the first row says so."""
        sign = condition[:1, -1:].sign() if len(condition) else 1.0
        return super().centres(condition) * torch.as_tensor(sign).reshape(-1, 1, 1)


class LosesState(Correct):
    """Forgets what it loaded."""

    name = "loses-state"

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """See :meth:`Method.load_state_dict`."""
        self.stretch = torch.tensor([0.5])


class NanAtZero(Correct):
    """The logarithm of a uniform that can be zero."""

    name = "nan-at-zero"

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = ()) -> Tensor:
        """Infinite where u is 0."""
        u = torch.cat([u[:, :1], 1 - (u[:, 1:2].log() * 1.0).exp(), u[:, 2:]], 1)
        wo = super().draw(condition, u)
        return torch.where((u[:, 1:2] == 1), torch.nan, wo)


class WrongShape(Correct):
    """Returns a column where a vector is due."""

    name = "wrong-shape"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return super().pdf(condition, wo)[:, None]


class ClampsTail(Bare):
    """Draws no point of a lobe beyond 3.5 deviations: those that would be are put there."""

    name = "clamps-tail"

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = Bare.weights) -> Tensor:
        """As if by a table of the inverse that ends early."""
        return super().draw(condition, u.clamp(max=1 - math.exp(-0.5 * 3.5**2)), share)


class FloorsPdf(Bare):
    """Reports at least 1e-4 inside the disk, so that nothing is ever divided by zero."""

    name = "floors-pdf"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        density = super().pdf(condition, wo)
        return torch.where(inside_disk(wo), density.clamp(min=1e-4), density)


class DropsLargeWeights(Bare):
    """Throws away samples whose weight would be large, and claims to cover them."""

    name = "drops-large-weights"

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = Bare.weights) -> Tensor:
        """Off the disk where f/p is above ten."""
        wo = super().draw(condition, u, share)
        assert self.material is not None
        large = self.material.target(condition, wo) > 10 * self.pdf(condition, wo)
        return torch.where(large[:, None], wo + 3, wo)


class FixedLaunch(Correct):
    """Fills at most 2^18 rows; the others stay zero."""

    name = "fixed-launch"

    def draw(
        self, condition: Tensor, u: Tensor, share: tuple[float, ...] = Correct.weights
    ) -> Tensor:
        """Zero beyond 2^18 rows."""
        wo = super().draw(condition, u, share)
        written = torch.arange(len(wo)) < 1 << 18
        return torch.where(written[:, None], wo, 0)


class NanOnBlack(Correct):
    """Divides by the material's own value, which a black texel makes 0/0."""

    name = "nan-on-black"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        assert self.material is not None
        scale = self.material.target(condition, torch.zeros_like(wo))
        return super().pdf(condition, wo) * (scale / scale)


class FailsToFit(Correct):
    """Raises while fitting."""

    name = "fails-to-fit"

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`Method.fit`."""
        raise FloatingPointError("loss is nan at step 3")


CAUGHT_BY: dict[type[Method], str] = {
    PdfTooLarge: "integral",
    ForgetsJacobian: "samples-pdf",
    MissesLobe: "samples-pdf",
    ClampsTail: "tail",
    FloorsPdf: "tail",
    DropsLargeWeights: "weights",
    HalfDisk: "coverage",
    WrongReportedPdf: "sample-pdf",
    MutatesInputs: "inputs-kept",
    IgnoresU: "same-u",
    ClampsToRim: "samples-pdf",
    FixedLaunch: "batch-half-million",
    SpreadsNan: "nan-confined",
    DependsOnRows: "rows",
    LosesState: "save-load",
    NanAtZero: "u-corners",
    NanOnBlack: "pdf-finite",
    WrongShape: "pdf-finite",
    FailsToFit: "fit",
}
"""Each wrong adapter and the property that has to find it."""

NEEDS: dict[type[Method], type[Material]] = {NanOnBlack: Soot}
"""The material on which a fault shows, where it is not :class:`Plaster`."""
