r"""Properties of single precision: against double precision, and with inputs in half.

A density evaluated in single precision is, at best, the exact density of slightly
different numbers. A dot product of n terms is exact for factors that differ by at most
:math:`n u` relative, :math:`u = 2^{-24}`; 64 terms are the widest layer that ships. So the
tolerance is not a number but a movement: inputs and state, each moved by :math:`64 u` of
itself in a random direction, ``DRAWS`` times, and the reference evaluated again. Where the
problem is ill-conditioned (deep in a lobe's flank, at the rim, on an edge), it moves much, and
so may the single-precision value; where it does not move, cancellation has no excuse.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from harness.checks.calling import compare
from harness.checks.edges import around, between
from harness.checks.finding import Finding, rounded
from harness.checks.subject import Case, Subject
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.method import DiskSample, Method

TESTS = 0

ROWS = 512
UNIT = 2.0**-24
"""Half a unit in the last place of one, in single precision."""
MOVED = 64 * UNIT
"""Backward error of a dot product of 64 terms."""
DRAWS = 4
SAFETY = 4.0
"""Times the range of ``DRAWS`` draws: that all of them miss the worst by so much is rare."""
EVALUATION = 160 * UNIT
"""Relative, where nothing moves: a hundred operations and some functions of Dr.Jit, which are
exact to a few units."""
SMALLEST = 2.0**-126
"""Below the least normal number single precision may flush to zero."""
HALF_MOVED = 4 * 2.0**-8
"""Backward error of a network in bfloat16: four units of its eight bits. Those of the 64 terms of a
dot product are of either sign."""


def check_float64(subject: Subject, case: Case) -> Iterator[Finding]:
    """Property ``float64``: ``pdf`` against ``reference_pdf``, and inputs in double precision.

    Without a reference, against ``pdf`` of inputs in double if that answers in double; inputs
    are then not moved in state. Skipped where it does neither.
    """
    name = "float64"
    condition = case.rows(ROWS)
    drawn = subject.sample(condition, subject.uniforms(ROWS)).wo[: ROWS // 2]
    even = square_to_disk(torch.rand(ROWS - len(drawn), 2, generator=subject.generator))
    wo = torch.cat([drawn, even.to(drawn)])
    # What is drawn at infinity is found elsewhere.
    wo = wo[wo.isfinite().all(-1)]
    condition = condition[: len(wo)]
    got = subject.pdf(condition, wo)
    answer = _or_refused(lambda: subject.pdf(condition.double(), wo.double()))
    if not isinstance(answer, str):
        yield from _same_in_double(case, condition, wo, got, answer)
    reference, methods = subject.method.reference_pdf, [subject.method]
    first = reference(condition, wo)
    if first is not None:
        methods = _perturbed(subject, MOVED)
    elif isinstance(answer, str):
        yield Finding(name, case.name, "skip", f"inputs in double are {answer}")
        return
    elif answer.dtype != torch.float64:
        yield Finding(name, case.name, "skip", "no reference, and pdf answers in single precision")
        return
    else:
        first, methods = answer, [subject.method] * DRAWS

    low, high = first.clone(), first.clone()
    for method in methods:
        # Rows of one condition stay so: some methods do much work for each new one.
        c = _move(case.rows(1).double(), MOVED, subject.generator).expand(len(condition), -1)
        c, o = c.clone(), _move(wo.double(), MOVED, subject.generator)
        plain = method.reference_pdf(c, o)
        value = method.pdf(c, o) if plain is None else plain
        low, high = torch.minimum(low, value), torch.maximum(high, value)
    yield _against(case, wo, got, first, low, high)


def _against(
    case: Case, wo: Tensor, got: Tensor, first: Tensor, low: Tensor, high: Tensor
) -> Finding:
    name = "float64"
    slack = SAFETY * (high - low) + EVALUATION * high + SMALLEST
    value = got.double()
    off = ~((value >= low - slack) & (value <= high + slack))
    # Where both are infinite or nan there is no difference, and `pdf-finite` speaks.
    off &= first.isfinite()
    apart = (value - first).abs() / torch.maximum(value.abs(), first.abs()).clamp(min=SMALLEST)
    apart = torch.where(first.isfinite(), apart, 0)
    number = float(apart.max())
    if not bool(off.any()):
        text = f"differs by at most {number:.1g} relative at {len(wo)} directions"
        return Finding(name, case.name, "pass", text, number=number, unit="relative")
    k = int(torch.where(off, apart.nan_to_num(torch.inf), -1).argmax())
    worst = {
        "condition": rounded(case.row),
        "wo": rounded(wo[k]),
        "got": rounded(got[k]),
        "expected": f"{rounded(first[k])} +- {rounded(slack[k])}",
    }
    text = f"single precision is off at {int(off.sum())} of {len(wo)} directions"
    return Finding(name, case.name, "fail", text, worst, number, "relative")


def _same_in_double(
    case: Case, condition: Tensor, wo: Tensor, got: Tensor, answer: Tensor
) -> Iterator[Finding]:
    """``pdf`` of the same numbers stored as doubles is no other number (coarse: 1 %)."""
    off = (got - answer).abs().double() > 0.01 * torch.maximum(got, answer).double() + SMALLEST
    if float(off.double().mean()) > 0.05:
        k = int(off.nonzero()[0, 0])
        worst = {
            "condition": rounded(condition[k]),
            "wo": rounded(wo[k]),
            "got": rounded(answer[k]),
            "expected": rounded(got[k]),
        }
        text = f"pdf of inputs in double differs in {int(off.sum())} of {len(off)} rows"
        yield Finding("float64", case.name, "fail", text, worst)


def _perturbed(subject: Subject, by: float) -> list[Method]:
    """Copies of the method, every number of the state moved; made once per method.

    Their random numbers are their own, so that one case alone has the same copies as all.
    """
    method, known = subject.kept.get(("moved", by), (None, []))
    if method is subject.method:
        return known
    copies, generator = [], subject.stream("moved", str(by))
    for _ in range(DRAWS):
        method = copy.deepcopy(subject.blank)
        method.bind(subject.material)
        state = {
            key: _move(value, by, generator) if value.is_floating_point() else value
            for key, value in subject.method.state_dict().items()
        }
        if state:
            method.load_state_dict({k: v.to(subject.device) for k, v in state.items()})
        copies.append(method)
    subject.kept["moved", by] = subject.method, copies
    return copies


def _move(value: Tensor, by: float, generator: torch.Generator) -> Tensor:
    """Every entry times 1 + ``by`` or 1 - ``by``."""
    sign = torch.randint(2, value.shape, generator=generator).to(value) * 2 - 1
    return value * (1 + by * sign)


def check_bfloat16(subject: Subject) -> Iterator[Finding]:
    """Property ``bfloat16``: half-precision inputs are refused, or answered as the same floats."""
    name = "bfloat16"
    condition = subject.conditions(4).repeat_interleave(ROWS // 4, 0).bfloat16()
    u = subject.uniforms(ROWS).bfloat16()
    # Rounded to eight bits some uniforms become one, which is none.
    u = torch.where(u < 1, u, 1 - 2.0**-8)
    plain, some = condition.float(), u.float()
    drawn = _or_refused(lambda: subject.sample(condition, u))
    if isinstance(drawn, str):
        yield Finding(name, "sample", "pass", drawn)
    else:
        got = DiskSample(drawn.wo.float(), drawn.pdf.float())
        rows = torch.arange(ROWS, device=subject.device)
        base = subject.sample(plain, some)
        finding = compare(subject, name, "sample", plain, some, base, got, rows)
        # Another direction may be as good, if its density is its own.
        yield finding if finding.ok else _coarse(subject, "sample", plain, got.wo, got.pdf)
    wo = square_to_disk(torch.rand(ROWS, 2, generator=subject.generator))
    wo = wo.to(subject.device).bfloat16()
    pdf = _or_refused(lambda: subject.pdf(condition, wo))
    if isinstance(pdf, str):
        yield Finding(name, "pdf", "pass", pdf)
        return
    # Numbers of eight bits lie on edges of cells, and rounding takes a side.
    low, middle, high = around(subject, plain, wo.float())
    finding = between(
        name,
        "pdf",
        plain,
        wo.float(),
        pdf.float(),
        torch.minimum(low, middle),
        torch.maximum(high, middle),
    )
    yield finding if finding.ok else _coarse(subject, "pdf", plain, wo.float(), pdf)


def _coarse(subject: Subject, case: str, condition: Tensor, wo: Tensor, got: Tensor) -> Finding:
    """Not as the floats, so computed in half precision: as well as that can be, or wrong.

    That well: half of the densities are among those of inputs and a state moved by
    ``HALF_MOVED``. The other half may be anything finite: deep in a flank all digits are lost.
    """
    got, exact = got.double(), subject.pdf(condition, wo).double()
    bad = int((~(got.isfinite() & (got >= 0))).sum())
    if bad:
        return Finding("bfloat16", case, "fail", f"not a density in {bad} of {len(got)} rows")
    low, high = exact.clone(), exact.clone()
    for method in _perturbed(subject, HALF_MOVED):
        c = _move(condition, HALF_MOVED, subject.generator)
        value = method.pdf(c, _move(wo, HALF_MOVED, subject.generator)).double()
        low, high = torch.minimum(low, value), torch.maximum(high, value)
    # Next to what the moved numbers span, the result's own eight bits.
    slack = (high - low) + HALF_MOVED * high
    off = ~((got >= low - slack) & (got <= high + slack))
    number = float(_relative(got, exact).median())
    text = f"computes in half precision: half of the densities are off by {number:.2g} or more"
    if float(off.double().mean()) <= 0.5:
        return Finding("bfloat16", case, "degraded", text, number=number, unit="relative")
    k = int(torch.where(off, _relative(got, exact), -1).argmax())
    worst = {
        "condition": rounded(condition[k]),
        "wo": rounded(wo[k]),
        "got": rounded(got[k]),
        "expected": f"{rounded(low[k])} to {rounded(high[k])} in half precision",
    }
    text = f"wrong even for half precision in {int(off.sum())} of {len(got)} rows"
    return Finding("bfloat16", case, "fail", text, worst, number, "relative")


def _relative(a: Tensor, b: Tensor) -> Tensor:
    """Difference relative to the larger."""
    return (a - b).abs() / torch.maximum(a, b).clamp(min=SMALLEST)


def _or_refused(call: Callable) -> Tensor | DiskSample | str:
    """The call's result, or how it was refused: an error of input, value or type.

    torch reports mixed types as a RuntimeError that names them, which is as clear.
    """
    try:
        return call()
    except (InputError, ValueError, TypeError) as error:
        return f"refused: {error}"
    except RuntimeError as error:
        if "type" not in str(error):
            raise
        return f"refused: {str(error).splitlines()[0]}"
