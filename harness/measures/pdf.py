"""How well a method's density follows the target, on conditions held out from fitting."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.fitting.targets import quadrature
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.densities import checked_density
from harness.stats import divergence

_ROWS = 1 << 20
_DIVERGENCES = {
    "kl": divergence.kl_divergence,
    "chi2": divergence.chi_square_divergence,
    "mse": divergence.mean_squared_error,
    "lost-share": divergence.lost_share,
}


class Pdf(Measure):
    r"""KL and chi-square divergence, MSE, invalid and lost shares; means over conditions.

    .. math:: D_{KL} = \int p^* \ln \frac{p^*}{p}, \qquad
              \chi^2 = \int \frac{p^{*2}}{p} - 1

    by quadrature over ``resolution``^2 directions, four in five of them drawn where p* is and the
    others uniformly (:func:`harness.fitting.targets.quadrature`): a peak is resolved, however
    narrow. They are the same for p*, p and all methods. The chi-square divergence is the variance
    of f / p over its squared mean under constant light. Both are infinite where p = 0 < p*; the
    share of p* that is so lost is a record of its own. Intervals are over conditions.
    ``negative-share`` is a fact of the material: how much of measured data is below zero.
    """

    name = "pdf"
    needs_scene = False

    class Settings(BaseSettings):
        """``conditions`` held-out conditions, ``samples`` drawn at each for the invalid share.

        ``resolution``: square root of the number of directions of the quadrature.
        """

        conditions: int = 128
        resolution: int = 128
        samples: int = 256

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings)) for job in jobs]

    def _one(self, job: Job, settings: Settings) -> Outcome:
        device, count = job.budget.device, settings.resolution**2
        condition = job.material.conditions(settings.conditions, job.generator, device)
        kept: list[torch.Tensor] = []
        found: dict[str, list[np.ndarray]] = {name: [] for name in _DIVERGENCES}
        step = max(1, _ROWS // count)
        for rows in torch.split(condition, step):
            wo, value, area = quadrature(job.material, rows, count, job.generator)
            value, area = value.double(), area.double()
            total = (value * area).sum(1, keepdim=True)
            # A black condition has no p* to be compared with.
            lit = total[:, 0] > 0
            target = value[lit] / total[lit]
            many = rows.repeat_interleave(count, 0)
            pdf = checked_density(job.method.pdf(many, wo.reshape(-1, 2)), job.method)
            pdf = pdf.view(len(rows), count)[lit].double()
            each = [v.cpu().numpy() for v in (target, pdf, area[lit])]
            for name, function in _DIVERGENCES.items():
                found[name].append(function(*each))
            kept.append(rows[lit])
        lit = torch.cat(kept)
        arrays = {name: single(np.concatenate(parts)) for name, parts in found.items()}
        arrays["invalid-share"] = self._invalid_share(job, lit, settings.samples)
        arrays["negative-share"] = self._negative_share(job, condition)
        arrays["condition"] = lit.cpu().numpy()
        return Outcome(arrays=arrays)

    @staticmethod
    def _negative_share(job: Job, condition: torch.Tensor) -> np.ndarray:
        """Share of uniform directions at which some channel of the BSDF is below zero [C]."""
        rows = condition.repeat_interleave(256, 0)
        u = torch.rand(len(rows), 2, generator=job.generator).to(rows.device)
        below = (job.material.eval(rows, square_to_disk(u)) < 0).any(1)
        return single(below.view(len(condition), 256).double().mean(1).cpu().numpy())

    @staticmethod
    def _invalid_share(job: Job, condition: torch.Tensor, samples: int) -> np.ndarray:
        """Share of samples off the disk, per condition that is not black."""
        u = torch.rand(len(condition) * samples, 3, generator=job.generator)
        many = condition.repeat_interleave(samples, 0)
        wo, pdf = job.method.sample(many, u.to(condition.device))
        checked_density(pdf, job.method, "sample's pdf")
        valid = inside_disk(wo).view(len(condition), samples).double().mean(1)
        return single((1 - valid).cpu().numpy())
