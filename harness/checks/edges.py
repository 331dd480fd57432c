"""Properties of the density where there is an edge: of the disk, of cells, of knots."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from harness.checks.finding import Finding, rounded
from harness.checks.subject import Subject

TESTS = 0

NEXT = 2.0**-22
"""To either side of an edge: a few units in the last place of one."""
AROUND = [(a * x, b * y) for a in (-1, 1) for b in (-1, 1) for x, y in ((1.0, 0.4), (0.4, 1.0))]
"""None along an axis: a step that stays on an edge does not see its sides."""
EDGE_TOLERANCE = 1e-4
FAR = (1.0 + 2.0**-23, 1.001, math.sqrt(2), 2.0, 1e3, 1e6, 1e9)
"""Radii outside the disk; a lobe of the widest deviation there is (e^10) draws beyond 1e5."""


def check_outside(subject: Subject) -> Finding:
    """Property ``outside-disk``: pdf is finite and not negative at directions off the disk.

    Not necessarily zero: a lobe may reach there, and its samples are invalid ones.
    """
    name = "outside-disk"
    turn = torch.arange(16) * (math.pi / 8)
    circle = torch.stack([turn.cos(), turn.sin()], -1)
    axes = torch.tensor([[2.0, 0.0], [0.0, -1.0], [-1.0, 1.0], [1e9, 0.0], [0.0, -1e9]])
    wo = torch.cat([*(radius * circle for radius in FAR), axes]).to(subject.device)
    rows = subject.conditions(4).clone()
    rows[0, -2:] = 0.0
    condition = rows.repeat_interleave(len(wo), 0)
    wo = wo.repeat(len(rows), 1)
    pdf = subject.pdf(condition, wo)
    bad = ~(pdf.isfinite() & (pdf >= 0))
    if not bool(bad.any()):
        reach = int((pdf > 0).sum())
        return Finding(name, "all", "pass", f"{len(wo)} directions, positive at {reach}")
    k = int(bad.nonzero()[0, 0])
    worst = {
        "condition": rounded(condition[k]),
        "wo": rounded(wo[k]),
        "got": rounded(pdf[k]),
        "expected": "a finite number >= 0",
    }
    text = f"wrong at {int(bad.sum())} of {len(wo)} directions off the disk"
    return Finding(name, "all", "fail", text, worst)


def check_edges(subject: Subject) -> Iterator[Finding]:
    """Property ``bin-edges``: on edges of cells, knots, axes and at the centre.

    ``pdf`` is finite there and one of the values next to it, or between them; samples made of
    dyadic uniforms report the density of where they are.
    """
    name = "bin-edges"
    rows = subject.conditions(3).clone()
    rows[0, -2:] = torch.tensor([0.5, 0.0])
    rows[1, -2:] = 0.0
    wo = _edges().to(subject.device)
    condition = rows.repeat_interleave(len(wo), 0)
    wo = wo.repeat(len(rows), 1)
    low, middle, high = around(subject, condition, wo)
    yield between(name, "pdf", condition, wo, middle, low, high)

    steps = torch.arange(32) / 32
    u = torch.cartesian_prod(steps[::2], steps, torch.tensor([0.0, 0.5])).to(subject.device)
    condition = rows.repeat_interleave(len(u), 0)
    u = u.repeat(len(rows), 1)
    drawn = subject.sample(condition, u)
    low, middle, high = around(subject, condition, drawn.wo)
    # Itself included: where it stands alone (a ridge), its own density is the right one.
    low, high = torch.minimum(low, middle), torch.maximum(high, middle)
    yield between(name, "sample", condition, drawn.wo, drawn.pdf, low, high)


def _edges() -> Tensor:
    """Dyadic points of the disk, the knots of ten bins, both axes, the centre: [n, 2]."""
    points = [torch.zeros(1, 2)]
    for step in (1 / 4, 1 / 16, 0.1):
        line = torch.arange(-int(1 / step), int(1 / step) + 1) * step
        points.append(torch.cartesian_prod(line, line))
    fine = torch.arange(-63, 64) / 64
    zero = torch.zeros_like(fine)
    points += [torch.stack([fine, zero], -1), torch.stack([zero, fine], -1)]
    wo = torch.cat(points).unique(dim=0)
    # At the rim one of the two sides is off the disk.
    return wo[wo.square().sum(-1) < 0.999]


def around(subject: Subject, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Least of the eight densities around ``wo``, the one at it, the largest of the eight."""
    middle = subject.pdf(condition, wo)
    low, high = torch.full_like(middle, torch.inf), torch.full_like(middle, -torch.inf)
    scale = NEXT * wo.abs().amax(-1, keepdim=True).clamp(min=1)
    for dx, dy in AROUND:
        there = subject.pdf(condition, wo + torch.tensor([dx, dy], device=wo.device) * scale)
        low, high = torch.minimum(low, there), torch.maximum(high, there)
    return low, middle, high


def between(
    name: str,
    case: str,
    condition: Tensor,
    wo: Tensor,
    got: Tensor,
    low: Tensor,
    high: Tensor,
) -> Finding:
    """Whether ``got`` is finite, not negative, and between ``low`` and ``high``."""
    finite = got.isfinite() & (got >= 0)
    # Every table of a mixture takes a side of its own where their edges meet, and that
    # combination may lie in none of the eight directions: once the range to either side.
    reach = (high - low) + EDGE_TOLERANCE * high
    fine = (got >= low - reach) & (got <= high + reach)
    off = ~(finite & fine)
    if not bool(off.any()):
        return Finding(name, case, "pass", f"{len(got)} directions")
    k = int(off.nonzero()[0, 0])
    worst = {
        "condition": rounded(condition[k]),
        "wo": rounded(wo[k]),
        "got": rounded(got[k]),
        "expected": f"between {rounded(low[k])} and {rounded(high[k])}",
    }
    text = f"wrong at {int(off.sum())} of {len(got)} directions"
    return Finding(name, case, "fail", text, worst)
