"""Properties of the density over many conditions: a number everywhere, and no light lost."""

from __future__ import annotations

import torch
from torch import Tensor

from harness.check.finding import Finding, rounded
from harness.check.subject import Case, Subject
from harness.protocol import square_to_disk

RANDOM = 12
"""Random conditions, next to the cases."""
RIM = (0.9999, 0.999999)
OFF = ((1.5, 0.0), (0.0, -1.01), (-1.0, 1.0))
LARGEST_UNIFORM = 1 - 2.0**-24
GRAZING_COSINE = 1e-3

LOST_ENERGY = 1e-4
"""Share of the reflectance that may have density zero; single precision underflows there."""
GRID = 64


def check_finite(subject: Subject, cases: list[Case]) -> Finding:
    """``pdf`` is a number and not negative: in the disk, at its rim, at its centre, outside."""
    condition, wo = _everywhere(subject, cases)
    pdf = subject.pdf(condition, wo)
    bad = ~(pdf.isfinite() & (pdf >= 0))
    if not bool(bad.any()):
        return Finding("pdf-finite", "all", True, f"{len(pdf)} directions")
    return _first("pdf-finite", bad, condition, wo, pdf, "a finite number >= 0")


def check_corners(subject: Subject, cases: list[Case]) -> Finding:
    """Uniforms of exactly 0 and of the largest number below 1 give samples as any others."""
    ends = torch.tensor([0.0, LARGEST_UNIFORM], device=subject.device)
    u = torch.cartesian_prod(ends, ends, ends)
    u = u.repeat(len(cases), 1)
    condition = torch.stack([case.row for case in cases]).repeat_interleave(8, 0)
    wo, pdf = subject.sample(condition, u)
    bad = ~(pdf.isfinite() & (pdf >= 0) & wo.isfinite().all(-1))
    if not bool(bad.any()):
        return Finding("u-corners", "all", True, f"{len(pdf)} samples")
    k = int(bad.nonzero()[0, 0])
    worst = {
        "condition": rounded(condition[k]),
        "u": rounded(u[k]),
        "wo": rounded(wo[k]),
        "pdf": rounded(pdf[k]),
    }
    return Finding(
        "u-corners", "all", False, f"not a sample in {int(bad.sum())} of {len(bad)}", worst
    )


def check_coverage(subject: Subject, case: Case) -> Finding:
    """p > 0 where f > 0. The share of the reflectance that is never sampled is the number."""
    name = "coverage"
    steps = torch.arange(GRID, device=subject.device)
    cells = torch.cartesian_prod(steps, steps)
    jitter = torch.rand(len(cells), 2, generator=subject.generator).to(subject.device)
    wo = square_to_disk((cells + jitter) / GRID)
    condition = case.rows(len(wo))
    target = subject.material.target(condition, wo).double()
    pdf = subject.pdf(condition, wo)
    if not bool(target.sum() > 0):
        return Finding(name, case.name, True, "the material is black here")
    lost = torch.where(pdf == 0, target, 0)
    share = float(lost.sum() / target.sum())
    text = f"{share:.2g} of the reflectance has density zero"
    if share <= LOST_ENERGY:
        return Finding(name, case.name, True, text)
    k = int(lost.argmax())
    worst = {
        "condition": rounded(case.row),
        "wo": rounded(wo[k]),
        "got": "pdf 0",
        "expected": f"> 0, for f = {rounded(target[k])}",
    }
    return Finding(name, case.name, False, text, worst)


def _everywhere(subject: Subject, cases: list[Case]) -> tuple[Tensor, Tensor]:
    """Conditions [N, C] (random ones, the cases, one almost horizontal) times directions."""
    horizontal = cases[0].row.clone()
    horizontal[-2:] = torch.tensor([-((1 - GRAZING_COSINE**2) ** 0.5), 0.0])
    rows = torch.stack([*(case.row for case in cases), horizontal])
    rows = torch.cat([rows, subject.conditions(RANDOM)])
    inner = square_to_disk(torch.rand(128, 2, generator=subject.generator))
    turn = torch.rand(16, generator=subject.generator) * 2 * torch.pi
    circle = torch.stack([turn.cos(), turn.sin()], -1)
    wo = torch.cat([inner, *(r * circle for r in RIM), torch.tensor(OFF), torch.zeros(1, 2)])
    wo = wo.to(subject.device)
    return rows.repeat_interleave(len(wo), 0), wo.repeat(len(rows), 1)


def _first(
    name: str, bad: Tensor, condition: Tensor, wo: Tensor, pdf: Tensor, expected: str
) -> Finding:
    k = int(bad.nonzero()[0, 0])
    worst = {
        "condition": rounded(condition[k]),
        "wo": rounded(wo[k]),
        "got": rounded(pdf[k]),
        "expected": expected,
    }
    return Finding(name, "all", False, f"wrong in {int(bad.sum())} of {len(bad)}", worst)
