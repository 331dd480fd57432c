r"""Where a method is a flow: ``inverse`` and ``sample`` undo one another.

A uniform in single precision is known to about :math:`2^{-24}`, a direction to about as
much; what either rounding does to the result depends on how steep the map is there. So
each tolerance is measured: by how much the result moves when the input is nudged by a few units
in the last place.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from harness.checks.finding import Finding, rounded
from harness.checks.subject import Case, Subject

TESTS = 0

ROWS = 2048
NUDGE = 2.0**-21
"""A few units in the last place of a number near one."""
SLACK = 1e-4
"""Next to what the nudges find: the maps' own rounding, in the input's and output's units."""
BEYOND = 0.05
"""Share of samples that may have no uniforms: a uniform share next to the flow, and its tails."""


def check_invertible(subject: Subject, case: Case) -> Finding:
    """Property ``invertible``: directions to uniforms and back, then uniforms to directions.

    Skipped where ``inverse`` gives None. A column that ``inverse`` sets to one number in all
    rows selects the flow from other ways to sample, and is given back that number.
    """
    name, method = "invertible", subject.method
    condition = case.rows(ROWS)
    uniforms = subject.uniforms(ROWS)
    wo = subject.sample(condition, uniforms).wo
    u = method.inverse(condition, wo)
    if u is None:
        return Finding(name, case.name, "skip", "no inverse: not a flow")
    if tuple(u.shape) != (ROWS, 3) or not bool(u.isfinite().all()):
        text = f"inverse gives {'nan or infinity' if u.shape == (ROWS, 3) else tuple(u.shape)}"
        return Finding(name, case.name, "fail", text, {"expected": f"finite uniforms ({ROWS}, 3)"})

    # A direction deep in the base's tail has no uniform in single precision: it came another way.
    edge = (u < NUDGE) | (u >= 1 - NUDGE)
    constant = (u == u[:1]).all(0)
    within = ~(edge & ~constant).any(-1)
    if float(within.double().mean()) < 1 - BEYOND:
        text = f"{1 - float(within.double().mean()):.1%} of the samples have no uniforms"
        return Finding(name, case.name, "fail", text, {"expected": f"at most {BEYOND:.0%}"})

    u = chosen = u.to(uniforms.dtype)

    def forward(u: Tensor) -> Tensor:
        # Uniforms stay in [0, 1), and a selector is what it was.
        u = torch.where(constant, chosen, u.clamp(0, 1 - 2.0**-24))
        return subject.sample(condition, u).wo

    def backward(wo: Tensor) -> Tensor:
        return method.inverse(condition, wo).to(uniforms.dtype)

    scale = wo.abs().amax(-1, keepdim=True).clamp(min=1)
    moved = (forward(u) - wo).abs() / scale
    far = within & (moved > SLACK + _spread(forward, u, 1.0) / scale).any(-1)
    if bool(far.any()):
        k = int(far.nonzero()[0, 0])
        worst = _worst(case, wo[k], u[k], forward(u)[k], wo[k])
        text = f"sample(inverse(wo)) is another wo in {int(far.sum())} of {ROWS} rows"
        return Finding(name, case.name, "fail", text, worst)

    given = torch.where(constant, u, uniforms)
    there = forward(given)
    back = backward(there)
    inside = ~(((given < NUDGE) | (given >= 1 - NUDGE)) & ~constant).any(-1)
    # Angles: just below one is next to zero.
    apart = _around(back - given)
    size = there.abs().amax(-1, keepdim=True).clamp(min=1)
    allowed = SLACK + _spread(backward, there, size, _around)
    far = inside & (apart > allowed).any(-1)
    if bool(far.any()):
        k = int(far.nonzero()[0, 0])
        worst = _worst(case, there[k], given[k], back[k], given[k])
        text = f"inverse(sample(u)) is another u in {int(far.sum())} of {ROWS} rows"
        return Finding(name, case.name, "fail", text, worst)
    number = float(moved[within].max())
    text = f"{int(within.sum())} directions and {int(inside.sum())} uniforms back, to {number:.1g}"
    return Finding(name, case.name, "pass", text, number=number)


def _spread(
    function: Callable[[Tensor], Tensor],
    at: Tensor,
    scale: Tensor | float,
    size: Callable[[Tensor], Tensor] = torch.abs,
) -> Tensor:
    """Sum over the columns of ``at`` of how far a nudge moves the function's value."""
    middle = function(at)
    total = torch.zeros_like(middle)
    for column in range(at.shape[1]):
        largest = torch.zeros_like(middle)
        for sign in (-1, 1):
            step = torch.zeros_like(at)
            step[:, column] = sign * NUDGE
            largest = torch.maximum(largest, size(function(at + step * scale) - middle))
        total = total + largest
    return total


def _around(difference: Tensor) -> Tensor:
    """Distance of numbers modulo one."""
    return (difference - difference.round()).abs()


def _worst(case: Case, wo: Tensor, u: Tensor, got: Tensor, expected: Tensor) -> dict[str, str]:
    return {
        "condition": rounded(case.row),
        "wo": rounded(wo),
        "u": rounded(u),
        "got": rounded(got),
        "expected": rounded(expected),
    }
