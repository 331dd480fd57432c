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
from scipy import stats
from torch import Tensor

from harness.check.evidence import Evidence, evidence
from harness.check.finding import Finding, Verdict, rounded
from harness.check.quadrature import (
    Hints,
    hemisphere_to_square,
    integrate,
    per_square,
    square_to_hemisphere,
)
from harness.check.subject import Case, Subject
from harness.protocol import DiskSample, cos_theta, inside_disk
from harness.stats.cells import Cells
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

GRID = 256
"""Stratified points per side of the hemisphere that look for f where p has no samples."""
RINGS = 24
"""Halvings of the radius around the mirror direction at which to begin looking for a lobe."""


class Furnace(NamedTuple):
    """Integrals [luminance] of f and of min(f, c p) over the disk, with standard errors."""

    whole: float
    whole_error: float
    capped: float
    capped_error: float


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
    seen = _look(found, subject.generator)
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
    yield _weights(case, weight, cap, furnace, alpha)
    text = f"{weight.max() / mean:.3g} times the mean, of {len(weight)} samples"
    number = float(weight.max()) / mean
    yield Finding("largest-weight", case.name, "pass", text, number=number, unit="x mean")
    yield _tail_index(case, weight, alpha)


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


class _Seen(NamedTuple):
    """Where f is: points [m, 2] of the square in proportion to f, f there, and its integral."""

    points: NDArray
    density: NDArray
    scale: float


def _look(found: Evidence, generator: torch.Generator) -> _Seen:
    """Points of the samples and of a stratified grid together, resampled in proportion to f.

    The balance heuristic: f / (n_grid * 1 + n p), with all densities per area of the square.
    """
    subject, case, rng = found.subject, found.case, _rng(generator)
    corner = np.stack(np.meshgrid(np.arange(GRID), np.arange(GRID)), -1).reshape(-1, 2)
    grid = (corner + rng.random(corner.shape)) / GRID
    spread = square_to_hemisphere(grid)[0].to(subject.device)
    points, valid = found.places
    inside = torch.from_numpy(valid).to(subject.device)
    mine, asked = found.drawn.wo.detach()[inside], found.asked.detach()[inside]
    pdf = torch.cat([subject.pdf(case.rows(len(spread)), spread).detach(), asked])
    points, wo = np.concatenate([grid, points]), torch.cat([spread, mine.to(spread.dtype)])
    jacobian = (2 * math.pi * cos_theta(wo)).double().cpu().numpy()
    target = jacobian * _target(subject, case, wo)
    density = jacobian * pdf.double().cpu().numpy()
    share = target / (len(grid) + len(valid) * density)
    # A density of nan or below zero is found elsewhere; here it is only no place to look.
    share = np.where(np.isfinite(share) & (share > 0), share, 0.0)
    if not share.any():
        return _Seen(points[:0], target[:0], 0.0)
    chosen = resampled(share, rng)
    return _Seen(points[chosen], target[chosen], float(share.sum()))


def resampled(share: NDArray, rng: np.random.Generator) -> NDArray:
    """Indices in proportion to ``share``, as many as it is worth: (sum)^2 / sum of squares."""
    share = share / share.sum()
    m = max(1, int(1 / np.square(share).sum()))
    at = (np.arange(m) + rng.random()) / m
    return np.minimum(np.searchsorted(share.cumsum(), at), len(share) - 1)


def _furnace(
    found: Evidence,
    seen: _Seen,
    weight: NDArray,
    cap: float,
    generator: torch.Generator,
) -> Furnace:
    subject, case, rng = found.subject, found.case, _rng(generator)
    near = _around_mirror(case.row)
    cells = Cells.uniform(4).refined(seen.points, max(1, len(seen.points) // 1024)).refined(near, 4)

    def target(wo: Tensor) -> Tensor:
        return torch.from_numpy(_target(subject, case, wo))

    whole = integrate(
        lambda wo: target(wo) / seen.scale,
        Hints(seen.points, seen.density / seen.scale),
        rng,
        cells,
    )
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
        whole.total * seen.scale, whole.error * seen.scale, part.total * scale, part.error * scale
    )


def _weights(case: Case, weight: NDArray, cap: float, found: Furnace, alpha: float) -> Finding:
    capped = np.minimum(weight, cap)
    mean, expected = float(capped.mean()), found.capped
    # Half of the level for the samples, half for the quadrature.
    allowed = (
        bernstein(capped.var(ddof=1), cap, len(weight), alpha / 2)
        + stats.norm.isf(alpha / 4) * found.capped_error
        + ROUNDING * expected
    )
    number = efficiency(weight)
    # Never below zero but by the integrals' own errors.
    above = 1 - expected / found.whole
    error = math.hypot(found.capped_error, found.whole_error) / found.whole
    text = (
        f"mean {mean:.5g}, albedo {expected:.5g} of {found.whole:.5g} up to weights of"
        f" {cap / mean:.3g} means, {above:.2g} above; efficiency {number:.3g}"
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
    elif number < INEFFICIENT or above - 3 * error > RESOLUTION:
        verdict = "degraded"
    return Finding("weights", case.name, verdict, text, worst, number, "efficiency")


def _tail_index(case: Case, weight: NDArray, alpha: float) -> Finding:
    """Heavy only if it is so at every one of ``TAILS``, and significantly at the first."""
    tails = [hill(weight, len(weight) // part) for part in TAILS]
    index, error = tails[0]
    if math.isinf(index):
        text = f"no tail: the largest 1/{TAILS[0]} of the weights are equal"
        return Finding("tail-index", case.name, "pass", text)
    heavy = index + stats.norm.isf(alpha) * error < FINITE_VARIANCE
    heavy = heavy and all(a < FINITE_VARIANCE for a, _ in tails)
    text = f"{index:.2f} +- {error:.2g}" + (": no finite variance" if heavy else "")
    verdict: Verdict = "degraded" if heavy else "pass"
    return Finding("tail-index", case.name, verdict, text, number=index)


def _no_number(subject: Subject, case: Case, drawn: DiskSample, weight: NDArray) -> Finding:
    bad = ~np.isfinite(weight)
    k = int(bad.argmax())
    target = float(_target(subject, case, drawn.wo[k : k + 1])[0])
    worst = {
        "condition": rounded(case.row),
        "wo": rounded(drawn.wo[k]),
        "got": f"pdf {rounded(drawn.pdf[k])}",
        "expected": f"> 0, for f = {rounded(target)}",
    }
    text = f"{int(bad.sum())} of {len(bad)} weights are not finite"
    return Finding("weights", case.name, "fail", text, worst)


def _target(subject: Subject, case: Case, wo: Tensor) -> NDArray:
    """f [N] per disk area, in double precision."""
    wo = wo.detach().to(subject.device)
    return subject.material.target(case.rows(len(wo)), wo).detach().double().cpu().numpy()


def _around_mirror(row: Tensor) -> NDArray:
    """Points of the square on rings around the mirror direction, [m, 2]."""
    turn = torch.arange(16) * (2 * math.pi / 16)
    circle = torch.stack([turn.cos(), turn.sin()], -1).double()
    radius = 0.5 ** torch.arange(2, RINGS, dtype=torch.float64)
    ring = (radius[:, None, None] * circle).reshape(-1, 2) - row[-2:].double().cpu()
    return hemisphere_to_square(ring)[0]


def _rng(generator: torch.Generator) -> np.random.Generator:
    return np.random.default_rng(int(torch.randint(1 << 62, (), generator=generator)))
