"""Properties of the density over many conditions: a number everywhere, and no light lost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from harness.checks import peaks
from harness.checks.evidence import SAMPLES, evidence
from harness.checks.finding import Finding, rounded
from harness.checks.quadrature import Hints, evaluate, integrate
from harness.checks.reflectance_points import resampled
from harness.checks.subject import Case, Subject
from harness.core.protocol.disk import square_to_disk
from harness.stats.cells import Cells

RANDOM = 6
"""Random conditions, next to the cases."""
INNER = 128
RIM = (0.9999, 0.999999)
OFF = ((1.5, 0.0), (0.0, -1.01), (-1.0, 1.0))
LARGEST_UNIFORM = 1 - 2.0**-24
GRAZING_COSINE = 1e-3

LOST_ENERGY = 1e-4
"""Share of the reflectance that may have density zero; single precision underflows there."""
LEVEL = 6
MOST_CELLS = 40_000


def check_finite(subject: Subject, cases: list[Case]) -> Finding:
    """Property ``pdf-finite``: a number, not negative: in the disk, at its rim and off it.

    In the conditions of ``cases``, one almost horizontal, and random ones.
    """
    horizontal = cases[0].row.clone()
    horizontal[-2:] = torch.tensor([-((1 - GRAZING_COSINE**2) ** 0.5), 0.0])
    rows = torch.stack([*(case.row for case in cases), horizontal])
    return _finite(subject, "all", torch.cat([rows, subject.conditions(RANDOM)]))


def check_finite_here(subject: Subject, case: Case) -> Finding:
    """Property ``pdf-finite`` in the condition of one case."""
    return _finite(subject, case.name, case.row[None])


def check_corners(subject: Subject, cases: list[Case]) -> Finding:
    """Property ``u-corners``: uniforms of exactly 0 and of the largest number below 1 are fit."""
    ends = torch.tensor([0.0, LARGEST_UNIFORM], device=subject.device)
    u = torch.cartesian_prod(ends, ends, ends)
    u = u.repeat(len(cases), 1)
    condition = torch.stack([case.row for case in cases]).repeat_interleave(8, 0)
    wo, pdf = subject.sample(condition.clone(), u.clone())
    bad = ~(pdf.isfinite() & (pdf >= 0) & wo.isfinite().all(-1))
    if not bool(bad.any()):
        return Finding("u-corners", "all", "pass", f"{len(pdf)} samples")
    k = int(bad.nonzero()[0, 0])
    worst = {
        "condition": rounded(condition[k]),
        "u": rounded(u[k]),
        "got": f"wo {rounded(wo[k])} pdf {rounded(pdf[k])}",
        "expected": "finite numbers, pdf >= 0",
    }
    text = f"not a sample in {int(bad.sum())} of {len(bad)}"
    return Finding("u-corners", "all", "fail", text, worst)


def check_coverage(subject: Subject, case: Case) -> Finding:
    """Property ``coverage``: p > 0 where f > 0. The number is the share of the reflectance lost.

    Integrated over cells that refine where f is. They begin with ``4**LEVEL``, finer where
    samples are and around the material's peaks: what is lit elsewhere, and much narrower than
    such a cell, may go unseen.
    """
    name = "coverage"
    rng = np.random.default_rng(int(torch.randint(1 << 62, (), generator=subject.generator)))

    def target(wo: Tensor) -> Tensor:
        wo = wo.to(subject.device)
        return subject.material.target(case.rows(len(wo)), wo).double()

    points, _ = evidence(subject, case).places
    cells = Cells.uniform(LEVEL).refined(points, SAMPLES // 256)
    cells = cells.refined(peaks.rings(peaks.centres(subject.material, case)), 4)
    first = evaluate(target, cells, rng)
    if not first.total > 0:
        return Finding(name, case.name, "pass", "the material is black here", number=0.0)
    # Steered by points in proportion to f, one for each cell that is worth one.
    full = resampled(first.mass, rng)
    centre = cells.corner[full] + cells.side[full, None] * rng.random((len(full), 2))
    hints = Hints(centre, (first.mass / cells.side**2 / first.total)[full])
    scale = first.total
    whole = integrate(lambda wo: target(wo) / scale, hints, rng, cells, MOST_CELLS)
    worst: dict[str, str] = {}

    def share(density: Callable[[Tensor, Tensor], Tensor]) -> float:
        """Of the reflectance where ``density`` is zero; notes the brightest such place."""

        def lost(wo: Tensor) -> Tensor:
            wo = wo.to(subject.device)
            value = torch.where(density(case.rows(len(wo)), wo) == 0, target(wo) / scale, 0)
            k = int(value.argmax())
            worst.update(
                condition=rounded(case.row),
                wo=rounded(wo[k]),
                got="pdf 0",
                expected=f"> 0, for f = {rounded(value[k] * scale)}",
            )
            return value

        return evaluate(lost, whole.cells, rng).total / whole.total

    number = share(subject.pdf)
    text = f"{number:.2g} of the reflectance has density zero"
    if number <= LOST_ENERGY:
        return Finding(name, case.name, "pass", text, number=number, unit="share")
    exact = subject.method.reference_pdf
    if exact(case.rows(1), case.row[None, -2:]) is not None:
        # Zero by underflow is no hole in the support, and single precision has no better number.
        hole = share(lambda condition, wo: exact(condition, wo))
        if hole <= LOST_ENERGY:
            text += ", by underflow: it is positive in double precision"
            return Finding(name, case.name, "degraded", text, {}, number, "share")
    return Finding(name, case.name, "fail", text, worst, number, "share")


def _finite(subject: Subject, case: str, rows: Tensor) -> Finding:
    """In the conditions ``rows`` [n, C]."""
    inner = square_to_disk(torch.rand(INNER, 2, generator=subject.generator))
    turn = torch.rand(16, generator=subject.generator) * 2 * torch.pi
    circle = torch.stack([turn.cos(), turn.sin()], -1)
    wo = torch.cat([inner, *(r * circle for r in RIM), torch.tensor(OFF), torch.zeros(1, 2)])
    # The mirrored direction too, where a narrow lobe is.
    wo = torch.cat([wo.to(rows).repeat(len(rows), 1, 1), -rows[:, None, -2:]], 1)
    condition = rows.repeat_interleave(wo.shape[1], 0)
    wo = wo.reshape(-1, 2)
    pdf = subject.pdf(condition.clone(), wo)
    bad = ~(pdf.isfinite() & (pdf >= 0))
    if not bool(bad.any()):
        return Finding("pdf-finite", case, "pass", f"{len(pdf)} directions")
    k = int(bad.nonzero()[0, 0])
    worst = {
        "condition": rounded(condition[k]),
        "wo": rounded(wo[k]),
        "got": rounded(pdf[k]),
        "expected": "a finite number >= 0",
    }
    text = f"wrong in {int(bad.sum())} of {len(bad)}"
    return Finding("pdf-finite", case, "fail", text, worst)
