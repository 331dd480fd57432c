"""Properties of the distribution in one condition: mass, shape, and the reported density."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from harness.checks.evidence import SAMPLES, Evidence, evidence
from harness.checks.finding import Finding, held, rounded
from harness.checks.quadrature import square_to_hemisphere
from harness.checks.subject import Case, Subject
from harness.stats.chisquare import chi_square
from harness.stats.distributions import normal_isf

MASS_TOLERANCE = 5e-4
"""What single precision may cost a density's integral."""
PDF_TOLERANCE = 1e-4
NUDGE = 2.0**-22
"""A few units in the last place of a coordinate of the disk, and as large a share of one beyond it:
how exactly a direction is known."""


def check_integral(subject: Subject, case: Case, alpha: float) -> Finding:
    """Property ``integral``: over the disk, the density's is the share of valid samples."""
    name, found = "integral", evidence(subject, case)
    total, error = found.masses.total, found.masses.error
    valid = float(found.places[1].mean())
    if not error < 0.01:
        return Finding(name, case.name, "fail", f"no integral found: {total:.5f} +- {error:.2g}")
    noise = math.hypot(error, math.sqrt(valid * (1 - valid) / SAMPLES))
    allowed = MASS_TOLERANCE + normal_isf(alpha / 2) * noise
    text = f"{total:.5f} +- {error:.1g} over the disk, {valid:.5f} of the samples valid"
    off = abs(total - valid)
    ok = off <= allowed
    if not ok:
        text += f" (may differ by {allowed:.2g})"
    worst = {"condition": rounded(case.row), "got": f"{total:.5f}", "expected": f"{valid:.5f}"}
    return Finding(name, case.name, held(ok), text, {} if ok else worst, off, "off")


def check_samples(subject: Subject, case: Case, alpha: float) -> Finding:
    """Property ``samples-pdf``: samples fall where the density says.

    Chi-square at level ``alpha``, with the invalid samples as one more cell. The number is the
    p-value.
    """
    name, found = "samples-pdf", evidence(subject, case)
    points, valid = found.places
    cells = found.coarse
    # Cells of the integral are finer; the coarse ones contain them.
    gathered = found.masses.gathered(cells)
    observed = np.append(cells.count(points), (~valid).sum())
    expected = SAMPLES * np.append(gathered.mass, 1 - gathered.total)
    variance = SAMPLES**2 * np.append(gathered.variance, gathered.error**2)
    if not np.isfinite(expected).all():
        return Finding(name, case.name, "fail", "not tested: the density is not finite")
    test = chi_square(observed, expected, variance)
    text = f"chi-square {test.statistic:.0f} for {test.dof} degrees, p = {test.p_value:.2g}"
    if test.p_value >= alpha:
        return Finding(name, case.name, "pass", text, {}, test.p_value, "p-value")
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
    text += f" (level {alpha:.1g})"
    return Finding(name, case.name, "fail", text, worst, test.p_value, "p-value")


def check_reported(subject: Subject, case: Case) -> Finding:
    """Property ``sample-pdf``: ``sample``'s pdf is ``pdf`` of the sample.

    Positive, and to ``PDF_TOLERANCE`` relative. Where a density is steep or jumps, the rounding
    of ``wo`` alone changes it by more; such a sample passes if its pdf lies among those of its
    neighbours at a distance of ``NUDGE``.
    """
    found = evidence(subject, case)
    condition, asked = found.condition, found.asked.detach()
    wo, reported = found.drawn.wo.detach(), found.drawn.pdf.detach()
    # At the rim itself, rounding decides whether a point is on the disk.
    inside = wo.square().sum(-1) < 1 - NUDGE
    if bool((bad := ~wo.isfinite().all(-1) | ~reported.isfinite() | ~asked.isfinite()).any()):
        return _bad_sample(found, bad, "wo or pdf is not finite")
    if bool((bad := inside & (reported <= 0)).any()):
        return _bad_sample(found, bad, "a valid sample has no density")
    off = (reported - asked).abs() > PDF_TOLERANCE * torch.maximum(reported, asked)
    rows = off.nonzero()[:, 0]
    if len(rows):
        low, high = _neighbours(subject, condition[rows], wo[rows], asked[rows])
        got = reported[rows]
        fine = (got >= low * (1 - PDF_TOLERANCE)) & (got <= high * (1 + PDF_TOLERANCE))
        off[rows[fine]] = False
    if bool(off.any()):
        return _bad_sample(found, off, "sample and pdf disagree")
    return Finding("sample-pdf", case.name, "pass", f"agrees for {len(wo)} samples")


def _neighbours(
    subject: Subject, condition: Tensor, wo: Tensor, middle: Tensor
) -> tuple[Tensor, Tensor]:
    """Least and largest density at ``wo`` and the eight points around it."""
    low, high = middle.clone(), middle.clone()
    nudge = NUDGE * wo.abs().clamp_min(1)
    for dx in (-1.0, 0.0, 1.0):
        for dy in (-1.0, 0.0, 1.0):
            there = subject.pdf(condition, wo + nudge * torch.tensor([dx, dy], device=wo.device))
            low, high = torch.minimum(low, there), torch.maximum(high, there)
    return low, high


def _bad_sample(found: Evidence, bad: Tensor, text: str) -> Finding:
    drawn, asked = found.drawn, found.asked
    error = (drawn.pdf - asked).abs() / torch.maximum(drawn.pdf, asked)
    # Among bad rows the largest error, and a row without any number before all others.
    worst = int(torch.where(bad, error.nan_to_num(torch.inf), -1).argmax())
    return Finding(
        "sample-pdf",
        found.case.name,
        "fail",
        f"{text} in {int(bad.sum())} of {len(bad)} samples",
        {
            "condition": rounded(found.case.row),
            "u": rounded(found.u[worst]),
            "wo": rounded(drawn.wo[worst]),
            "got": f"{rounded(drawn.pdf[worst])} by sample",
            "expected": f"{rounded(asked[worst])} by pdf",
        },
    )
