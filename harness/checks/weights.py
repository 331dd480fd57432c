r"""Properties of the weights w = f/p: their mean is the albedo, and how unequal they are.

Weights may have no variance, so their plain mean cannot be tested. Cut off at a cap c they are
bounded, whatever the tail, and

.. math:: E[\min(w, c)] = \int \min(f, c\,p)\,dA

is tested with the empirical Bernstein bound (:mod:`harness.stats.weights`).
The cap is the largest at which that bound is within ``RESOLUTION`` of the mean, by a pilot
of samples of its own. What lies above the cap is a number, not a test.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.checks import peaks
from harness.checks.evidence import Evidence, evidence
from harness.checks.finding import Finding, Verdict, rounded
from harness.checks.quadrature import Hints, Masses, evaluate, integrate, per_square
from harness.checks.reflectance_points import Seen, look, reflectance, resampled
from harness.checks.subject import Case, Subject
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.method import DiskSample
from harness.stats.cells import Cells
from harness.stats.distributions import normal_isf
from harness.stats.weights import bernstein, choose_cap, efficiency, hill

TESTS = 2
"""Statistical tests per case: the furnace, and whether the tail index is below two."""

RESOLUTION = 0.05
"""Relative error of the mean that the furnace test is to see: a twentieth of the albedo."""
ROUNDING = 5e-4
"""Relative: what single precision may cost an integral."""
INEFFICIENT = 0.01
"""Below this a hundred samples do the work of less than one: correct, and of no use."""
RIM = 2.0**-22
"""A few units in the last place of a squared radius near one."""
MOSTLY_INVALID = 0.5
"""Above this share more samples are thrown away than used."""
FINITE_VARIANCE = 2.0
"""Tail index (of P(w > t) ~ t^-a) below which the variance is infinite."""
TAILS = (100, 400, 1600)
"""The largest 1/100, ... of the weights are the tail. Two bounded levels look heavy at one."""


class Furnace(NamedTuple):
    """Integrals [luminance] of f and of min(f, c p) over the disk, with standard errors.

    ``cells`` are fine where f is.
    """

    whole: float
    whole_error: float
    capped: float
    capped_error: float
    cells: Cells

    @property
    def above(self) -> float:
        """Share of the energy in weights above the cap, or that no sample found."""
        # Never below zero but by the integrals' own errors.
        return 1 - self.capped / self.whole

    @property
    def is_rare(self) -> bool:
        """Whether that share is more than ``RESOLUTION``, and not by the integrals' errors."""
        error = math.hypot(self.capped_error, self.whole_error) / self.whole
        return self.above - 3 * error > RESOLUTION


def check_weights(subject: Subject, case: Case, alpha: float) -> Iterator[Finding]:
    """Findings ``weights`` (number: efficiency), ``largest-weight``, ``tail-index``, ``invalid``.

    ``alpha`` is the level of each of the ``TESTS`` tests.
    """
    found = evidence(subject, case)
    drawn = found.drawn
    weight, valid = weights(subject, case, drawn)
    share = 1 - float(valid.mean())
    yield Finding(
        "invalid",
        case.name,
        "degraded" if share > MOSTLY_INVALID else "pass",
        f"{share:.2%} of the samples are off the disk",
        number=share,
    )
    if not np.isfinite(weight).all():
        yield _no_number(subject, case, drawn, weight)
        return
    seen = look(found, rng_of(subject.generator))
    if seen.scale == 0:
        yield Finding("weights", case.name, "pass", "the material is black here")
        return
    mean = float(weight.mean())
    cap = choose_cap(weights(subject, case, found.pilot)[0], len(weight), alpha, RESOLUTION)
    if mean == 0 or cap == 0:
        lit = int((weight > 0).sum())
        text = f"{lit} of {len(weight)} samples find the reflectance: too few to test their mean"
        number = efficiency(weight) if lit else 0.0
        yield Finding("weights", case.name, "degraded", text, number=number, unit="efficiency")
        return
    furnace = _furnace(found, seen, weight, cap, subject.generator)
    yield _weights(found, weight, cap, furnace, alpha)
    text = f"{weight.max() / mean:.3g} times the mean, of {len(weight)} samples"
    number = float(weight.max()) / mean
    yield Finding("largest-weight", case.name, "pass", text, number=number, unit="x mean")
    yield tail_index(case, weight, alpha)


def weights(subject: Subject, case: Case, drawn: DiskSample) -> tuple[NDArray, NDArray]:
    """f/p [N] of the samples, 0 for invalid ones, and which are valid, bool [N]."""
    wo, pdf = drawn.wo.detach(), drawn.pdf.detach().double()
    # On the rim itself rounding decides whether a point is on the disk; a density of zero says no.
    valid = inside_disk(wo) & ((wo.square().sum(-1) < 1 - RIM) | (pdf != 0))
    target = subject.material.target(case.rows(len(wo)), wo).double()
    weight = torch.where(valid, target / pdf, 0.0)
    # A negative density is no density; without this it would pass for a small weight.
    weight = torch.where(valid & ~(pdf > 0), torch.nan, weight)
    return weight.cpu().numpy(), valid.cpu().numpy()


def _furnace(
    found: Evidence,
    seen: Seen,
    weight: NDArray,
    cap: float,
    generator: torch.Generator,
) -> Furnace:
    subject, case, rng = found.subject, found.case, rng_of(generator)

    def target(wo: Tensor) -> Tensor:
        return torch.from_numpy(reflectance(subject, case, wo))

    whole = integral_of_f(found, seen, rng)
    places, inside = found.places
    capped = np.minimum(weight[inside], cap)
    scale = float(capped.sum() / len(weight))
    chosen = resampled(capped, rng)
    value = capped * per_square(found.drawn.pdf, found.drawn.wo)[inside] / scale

    def bounded(wo: Tensor) -> Tensor:
        pdf = subject.pdf(case.rows(len(wo)), wo.to(subject.device)).detach().double().cpu()
        return torch.minimum(target(wo), cap * pdf) / scale

    part = integrate(bounded, Hints(places[chosen], value[chosen]), rng, whole.cells)
    return Furnace(
        whole.total * seen.scale,
        whole.error * seen.scale,
        part.total * scale,
        part.error * scale,
        whole.cells,
    )


def integral_of_f(found: Evidence, seen: Seen, rng: np.random.Generator) -> Masses:
    """Integral of f over the disk, in units of ``seen.scale``."""
    subject, case = found.subject, found.case
    near = peaks.rings(peaks.centres(subject.material, case))
    cells = Cells.uniform(4).refined(seen.points, max(1, len(seen.points) // 1024)).refined(near, 4)
    return integrate(
        lambda wo: torch.from_numpy(reflectance(subject, case, wo)) / seen.scale,
        Hints(seen.points, seen.density / seen.scale),
        rng,
        cells,
    )


def _efficiency(
    found: Evidence, weight: NDArray, cap: float, furnace: Furnace, rng: np.random.Generator
) -> float:
    r""":math:`E[w]^2 / E[w^2]`, of the samples below the cap and the integral of f^2 / p above.

    What no sample has found counts here with the weight it will have one day.
    """
    subject, case = found.subject, found.case

    def square(wo: Tensor) -> Tensor:
        wo = wo.to(subject.device)
        pdf = subject.pdf(case.rows(len(wo)), wo).detach().double().cpu()
        target = torch.from_numpy(reflectance(subject, case, wo))
        # Where p = 0 < f the weight is infinite, and the efficiency zero. On the rim itself
        # rounding decides whether f and each part of p are there at all.
        inside = (wo.square().sum(-1) < 1 - RIM).cpu()
        return torch.where(inside & (target > cap * pdf), target.square() / pdf, 0)

    rest = evaluate(square, furnace.cells, rng).mass.sum()
    return float(furnace.whole**2 / (np.square(weight[weight <= cap]).sum() / len(weight) + rest))


def _weights(
    found: Evidence, weight: NDArray, cap: float, furnace: Furnace, alpha: float
) -> Finding:
    case, capped = found.case, np.minimum(weight, cap)
    mean, expected = float(capped.mean()), furnace.capped
    # Half of the level for the samples, half for the quadrature.
    allowed = (
        bernstein(capped.var(ddof=1), cap, len(weight), alpha / 2)
        + normal_isf(alpha / 4) * furnace.capped_error
        + ROUNDING * expected
    )
    number, said = efficiency(weight), ""
    if furnace.is_rare:
        said = f" ({number:.3g} by what the samples found)"
        number = _efficiency(found, weight, cap, furnace, rng_of(found.subject.generator))
    text = (
        f"mean {mean:.5g}, albedo {expected:.5g} of {furnace.whole:.5g} up to weights of"
        f" {cap / mean:.3g} means, {furnace.above:.2g} above; efficiency {number:.3g}{said}"
    )
    verdict: Verdict = "pass"
    worst = {}
    if not abs(mean - expected) <= allowed:
        verdict = "fail"
        text = f"mean weight {mean:.5g}, expected {expected:.5g} +- {allowed:.2g}"
        worst = {
            "condition": rounded(case.row),
            "got": f"{mean:.6g}",
            "expected": f"{expected:.6g}",
            "cap": f"{cap:.4g}",
        }
    elif number < INEFFICIENT or furnace.is_rare:
        verdict = "degraded"
    return Finding("weights", case.name, verdict, text, worst, number, "efficiency")


def tail_index(case: Case, weight: NDArray, alpha: float) -> Finding:
    """Heavy only if it is so at every one of ``TAILS``, and significantly at the first."""
    tails = [hill(weight, len(weight) // part) for part in TAILS]
    index, error = tails[0]
    if math.isinf(index):
        text = f"no tail: the largest 1/{TAILS[0]} of the weights are equal"
        return Finding("tail-index", case.name, "pass", text)
    heavy = index + normal_isf(alpha) * error < FINITE_VARIANCE
    heavy = heavy and all(a < FINITE_VARIANCE for a, _ in tails)
    text = f"{index:.2f} +- {error:.2g}" + (": no finite variance" if heavy else "")
    verdict: Verdict = "degraded" if heavy else "pass"
    return Finding("tail-index", case.name, verdict, text, number=index)


def _no_number(subject: Subject, case: Case, drawn: DiskSample, weight: NDArray) -> Finding:
    bad = ~np.isfinite(weight)
    k = int(bad.argmax())
    target = float(reflectance(subject, case, drawn.wo[k : k + 1])[0])
    worst = {
        "condition": rounded(case.row),
        "wo": rounded(drawn.wo[k]),
        "got": f"pdf {rounded(drawn.pdf[k])}",
        "expected": f"> 0, for f = {rounded(target)}",
    }
    text = f"{int(bad.sum())} of {len(bad)} weights are not finite"
    return Finding("weights", case.name, "fail", text, worst)


def rng_of(generator: torch.Generator) -> np.random.Generator:
    return np.random.default_rng(int(torch.randint(1 << 62, (), generator=generator)))
