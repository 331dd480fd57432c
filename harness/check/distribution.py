"""Properties of the distribution in one condition: mass, shape, and the reported density."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import torch
from scipy import stats
from torch import Tensor

from harness.check.finding import Finding, rounded
from harness.check.quadrature import (
    Hints,
    hemisphere_to_square,
    integrate,
    per_square,
    square_to_hemisphere,
)
from harness.check.subject import Case, Subject
from harness.protocol import DiskSample
from harness.stats.cells import Cells
from harness.stats.chisquare import chi_square

PILOT = 1 << 15
SAMPLES = 1 << 17
TESTS = 2
"""Statistical tests per case."""

MASS_TOLERANCE = 5e-4
"""What single precision may cost a density's integral."""
PDF_TOLERANCE = 1e-4
NUDGE = 2.0**-22
"""A few units in the last place of a coordinate: how exactly a direction is known."""


def check_distribution(subject: Subject, case: Case, alpha: float) -> Iterator[Finding]:
    """Integral, goodness of fit, and the density that ``sample`` reports.

    ``alpha`` is the level of each of the ``TESTS`` statistical tests.
    """
    pilot, _ = hemisphere_to_square(_draw(subject, case, PILOT)[0].wo)
    drawn, condition = _draw(subject, case, SAMPLES)
    asked = subject.pdf(condition, drawn.wo)
    yield _reported_density(subject, case, condition, drawn, asked)

    points, valid = hemisphere_to_square(drawn.wo)
    hints = Hints(points, per_square(asked, drawn.wo)[valid])
    coarse = Cells.uniform(4).refined(pilot, PILOT // 256)
    rng = np.random.default_rng(int(torch.randint(1 << 62, (), generator=subject.generator)))
    masses = integrate(
        lambda wo: subject.pdf(case.rows(len(wo)), wo.to(subject.device)),
        hints,
        rng,
        coarse.refined(points, SAMPLES // 4096),
    )
    yield _integral(case, masses.total, masses.error, float(valid.mean()), alpha)

    # Cells differ in where they are refined; the coarse ones contain the fine.
    gathered = masses.gathered(coarse)
    observed = np.append(coarse.count(points), (~valid).sum())
    expected = SAMPLES * np.append(gathered.mass, 1 - gathered.total)
    variance = SAMPLES**2 * np.append(gathered.variance, gathered.error**2)
    yield _fit(case, coarse, observed, expected, variance, alpha)


def _draw(subject: Subject, case: Case, n: int) -> tuple[DiskSample, Tensor]:
    condition = case.rows(n)
    return subject.sample(condition, subject.uniforms(n)), condition


def _integral(case: Case, total: float, error: float, valid: float, alpha: float) -> Finding:
    """The density's integral over the disk is the share of valid samples."""
    name = "integral"
    if not error < 0.01:
        return Finding(name, case.name, False, f"no integral found: {total:.5f} +- {error:.2g}")
    noise = math.hypot(error, math.sqrt(valid * (1 - valid) / SAMPLES))
    allowed = MASS_TOLERANCE + stats.norm.isf(alpha / 2) * noise
    text = f"{total:.5f} +- {error:.1g} over the disk, {valid:.5f} of the samples valid"
    ok = abs(total - valid) <= allowed
    if not ok:
        text += f" (may differ by {allowed:.2g})"
    worst = {"condition": rounded(case.row), "got": f"{total:.5f}", "expected": f"{valid:.5f}"}
    return Finding(name, case.name, ok, text, {} if ok else worst)


def _fit(
    case: Case,
    cells: Cells,
    observed: np.ndarray,
    expected: np.ndarray,
    variance: np.ndarray,
    alpha: float,
) -> Finding:
    """Samples fall where the density says: chi-square, invalid samples as one more cell."""
    name = "samples-pdf"
    if not np.isfinite(expected).all():
        return Finding(name, case.name, False, "not tested: the density is not finite")
    test = chi_square(observed, expected, variance)
    ok = test.p_value >= alpha
    text = f"chi-square {test.statistic:.0f} for {test.dof} degrees, p = {test.p_value:.2g}"
    if ok:
        return Finding(name, case.name, True, text)
    w = test.worst
    at = "off the disk"
    if w < len(cells):
        centre = cells.corner[w : w + 1] + cells.side[w] / 2
        at = rounded(square_to_hemisphere(centre)[0][0])
    worst = {
        "condition": rounded(case.row),
        "wo": at,
        "got": f"{observed[w]:.0f} samples",
        "expected": f"{expected[w]:.1f}",
    }
    return Finding(name, case.name, False, text + f" (level {alpha:.1g})", worst)


def _reported_density(
    subject: Subject, case: Case, condition: Tensor, drawn: DiskSample, asked: Tensor
) -> Finding:
    """``sample``'s pdf is ``pdf`` of the sample, positive, to ``PDF_TOLERANCE`` relative.

    Where a density is steep or jumps, the rounding of ``wo`` alone changes it by more; such a
    sample passes if its pdf lies among those of its neighbours at a distance of ``NUDGE``.
    """
    name = "sample's-pdf"
    wo, reported = drawn.wo.detach(), drawn.pdf.detach()
    # At the rim itself, rounding decides whether a point is on the disk.
    inside = wo.square().sum(-1) < 1 - NUDGE
    if bool((bad := ~wo.isfinite().all(-1) | ~reported.isfinite() | ~asked.isfinite()).any()):
        return _bad_sample(case, drawn, asked, bad, "wo or pdf is not finite")
    if bool((bad := inside & (reported <= 0)).any()):
        return _bad_sample(case, drawn, asked, bad, "a valid sample has no density")
    off = (reported - asked).abs() > PDF_TOLERANCE * torch.maximum(reported, asked)
    rows = off.nonzero()[:, 0]
    if len(rows):
        low, high = _neighbours(subject, condition[rows], wo[rows], asked[rows])
        got = reported[rows]
        fine = (got >= low * (1 - PDF_TOLERANCE)) & (got <= high * (1 + PDF_TOLERANCE))
        off[rows[fine]] = False
    if bool(off.any()):
        return _bad_sample(case, drawn, asked, off, "sample and pdf disagree")
    return Finding(name, case.name, True, f"agrees for {len(wo)} samples")


def _neighbours(
    subject: Subject, condition: Tensor, wo: Tensor, middle: Tensor
) -> tuple[Tensor, Tensor]:
    """Least and largest density at ``wo`` and the eight points around it."""
    low, high = middle.clone(), middle.clone()
    for dx in (-NUDGE, 0.0, NUDGE):
        for dy in (-NUDGE, 0.0, NUDGE):
            there = subject.pdf(condition, wo + torch.tensor([dx, dy], device=wo.device))
            low, high = torch.minimum(low, there), torch.maximum(high, there)
    return low, high


def _bad_sample(case: Case, drawn: DiskSample, asked: Tensor, bad: Tensor, text: str) -> Finding:
    error = (drawn.pdf - asked).abs() / torch.maximum(drawn.pdf, asked)
    # Among bad rows the largest error, and a row without any number before all others.
    worst = int(torch.where(bad, error.nan_to_num(torch.inf), -1).argmax())
    return Finding(
        "sample's-pdf",
        case.name,
        False,
        f"{text} in {int(bad.sum())} of {len(bad)} samples",
        {
            "condition": rounded(case.row),
            "wo": rounded(drawn.wo[worst]),
            "sample gave": rounded(drawn.pdf[worst]),
            "pdf gives": rounded(asked[worst]),
        },
    )
