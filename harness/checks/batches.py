"""Half a million rows in one call are the same rows as in small calls."""

from __future__ import annotations

import torch
from torch import Tensor

from harness.checks.calling import QUADRANTS, TOLERANCE, compare
from harness.checks.finding import Finding, rounded
from harness.checks.subject import Subject

TESTS = 0

ROWS = (1 << 19) + 1
"""Above 2^18, at which launches of a fixed size stop writing, and no multiple of anything."""
NEAR = 256
"""Rows looked at on each side of a power of two, at both ends, and in between."""


def check_half_million(subject: Subject) -> Finding:
    """Property ``batch-half-million``: one call of ``ROWS`` rows against small ones.

    Conditions come in four long runs, for methods whose work is per condition.
    """
    name = "batch-half-million"
    distinct = subject.conditions(len(QUADRANTS)).clone()
    signs = torch.tensor(QUADRANTS, device=subject.device)
    distinct[:, -2:] = distinct[:, -2:].abs() * signs
    condition = distinct.repeat_interleave(-(-ROWS // len(QUADRANTS)), 0)[:ROWS].clone()
    u = subject.uniforms(ROWS)
    base = subject.sample(condition, u)
    density = subject.pdf(condition, base.wo)
    rows = _rows(subject)
    small, some = condition[rows].clone(), u[rows].clone()
    # The small calls are the truth, so that a difference is looked into with few rows.
    expected = subject.sample(small, some)
    got = type(base)(base.wo[rows], base.pdf[rows])
    every = torch.arange(len(rows), device=subject.device)
    finding = compare(subject, name, "all", small, some, expected, got, every)
    if not finding.ok:
        return finding
    again = subject.pdf(small, base.wo[rows])
    off = ~((again - density[rows]).abs() <= TOLERANCE * torch.maximum(again, density[rows]))
    if bool(off.any()):
        k = int(off.nonzero()[0, 0])
        worst = {
            "row": int(rows[k]),
            "condition": rounded(small[k]),
            "wo": rounded(base.wo[rows[k]]),
            "got": rounded(density[rows[k]]),
            "expected": rounded(again[k]),
        }
        text = f"pdf differs in {int(off.sum())} of the {len(rows)} rows looked at"
        return Finding(name, "all", "fail", text, worst)
    return Finding(name, "all", "pass", f"{len(rows)} of {ROWS} rows as in small calls")


def _rows(subject: Subject) -> Tensor:
    """Row numbers to look at: around powers of two from 2^16 up, the ends, and random ones."""
    near = torch.arange(-NEAR, NEAR)
    marks = [NEAR, *(1 << k for k in range(16, 20)), ROWS - NEAR]
    rows = torch.cat([*(mark + near for mark in marks)])
    random = torch.randint(ROWS, (4 * NEAR,), generator=subject.generator)
    rows = torch.cat([rows, random, torch.tensor([ROWS - 1])])
    return rows[(rows >= 0) & (rows < ROWS)].unique().to(subject.device)
