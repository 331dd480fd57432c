"""What one sample is worth under constant light: variance and bias of its weight, by condition."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from harness.core.protocol.disk import luminance
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.materials.families.walks import WalkFamily
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.densities import checked_density

_ROWS = 1 << 18
_REFERENCES = ("random-walk", "native", "cosine")
"""Samplers of the albedo, from the least variance to the one that every material has."""


class SampleWeights(Measure):
    r"""Relative variance and bias of the luminance of the weight, at held-out conditions.

    A weight w is f/p, or a method's own estimate. Its mean is the albedo A of the condition if
    the method is unbiased; var(w) / A^2 is the variance of a pixel of that condition alone, in
    constant light, of one sample. The means over pixels of a render weigh bright conditions more.

    - ``relative-variance``, ``relative-variance-median`` over conditions;
    - ``noise-free-variance``, ``noise-free-variance-median``: the same if f were known. Where f
      is a mean over random walks, f/p contains that mean's noise; of w and w', weights by
      different walks at the same directions, the covariance is free of it. Equal to the variance
      where f is a closed form or no part of the weight;
    - ``bias``: mean over conditions of E[w] / A - 1;
    - ``bias-rms``: root of the mean square of that, without what noise adds to it. After N
      samples the relative squared error is ``bias-rms``^2 + ``relative-variance`` / N. Zero if the
      estimate of the mean square is not positive, which for an unbiased method it is half the time;
    - ``biased-share``: share of conditions whose mean differs from the albedo by more than three
      standard errors (0.003 for an unbiased method with well-behaved weights).

    The albedo is estimated by another sampler, a random walk where the material has one. All
    methods of a material see the same conditions and uniforms.
    """

    name = "sample-weights"
    needs_scene = False

    class Settings(BaseSettings):
        """``samples`` at each of ``conditions``, four times as many for the albedo."""

        conditions: Annotated[int, Field(ge=2)] = 128
        samples: Annotated[int, Field(ge=2)] = 4096

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        condition = job.material.conditions(settings.conditions, job.generator, job.budget.device)
        notify(f"{job.material.name}: albedos")
        truth, truth_error, _ = _moments(_reference(job.material), condition, settings, job, 4)
        lit = truth > 0
        condition, truth, truth_error = condition[lit], truth[lit], truth_error[lit]
        notify(f"{job.material.name}: {len(condition)} conditions of {job.method.name}")
        mean, error, noise = _moments(job.method, condition, settings, job)
        # In double precision: small differences of these are what is looked for.
        arrays = {
            "condition": condition.cpu().numpy(),
            "albedo": truth,
            "albedo_error": truth_error,
            "mean": mean,
            "variance": error**2 * settings.samples,
            "noise": noise,
        }
        return Outcome(arrays=arrays)


def _reference(material: Material) -> Method:
    """A sampler of the material that nothing was fitted for."""
    from harness.core import registry

    for name in _REFERENCES:
        method = registry.make(name)
        if method.supports(material)[0]:
            break
    method.bind(material)
    return method


def _moments(
    method: Method, condition: Tensor, settings: SampleWeights.Settings, job: Job, times: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean weight, its standard error, and the noise of f in one weight's variance: each [K]."""
    samples = settings.samples * times
    again = _by_other_walks(method)
    found: list[list[Tensor]] = []
    for rows in torch.split(condition, max(1, _ROWS // samples)):
        many = rows.repeat_interleave(samples, 0)
        u = torch.rand(len(many), 3, generator=job.generator).to(many.device)
        drawn = method.sample_weighted(many, u)
        checked_density(drawn.pdf, method, "sample's pdf")
        w = luminance(drawn.weight).double()
        other = luminance(again.sample_weighted(many, u).weight).double() if again else w
        w, other = w.view(-1, samples), other.view(-1, samples)
        mean, variance = w.mean(1), w.var(1)
        off, other_off = w - mean[:, None], other - other.mean(1)[:, None]
        covariance = (off * other_off).sum(1) / (samples - 1)
        found.append([mean, (variance / samples).sqrt(), variance - covariance])
    mean, error, noise = (torch.cat(parts).cpu().numpy() for parts in zip(*found, strict=True))
    return mean, error, noise


def _by_other_walks(method: Method) -> Method | None:
    """``method`` with f by random walks of another seed; None where f is no mean over walks."""
    if not isinstance(method.material, WalkFamily):
        return None
    other = copy.copy(method.material)
    other.eval_columns = functools.partial(method.material.eval_columns, seed=1)
    return method.rebound(other)
