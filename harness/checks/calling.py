"""Properties of the calls: inputs kept, rows independent, reproducible, restorable."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator

import safetensors.torch
import torch
from torch import Tensor

from harness.checks.finding import Finding, held, rounded
from harness.checks.subject import Subject
from harness.core.protocol.errors import InputError
from harness.core.protocol.method import DiskSample

ROWS = 1025
QUADRANTS = ((1.0, 1.0), (-1.0, -1.0))
"""One condition in each, in runs of rows: some methods do much work for each new one. Opposite
ones, so that a sign or frame taken from another row is wrong in both coordinates."""
TOLERANCE = 1e-3
"""Absolute for ``wo``, relative for densities, between two evaluations of one row."""
U_NUDGE = 1e-5
"""By how much rounding in a cdf may move a uniform (1e-5: many units in the last place)."""


def check_inputs_kept(subject: Subject) -> Finding:
    """``sample`` and ``pdf`` write to none of their inputs."""
    condition, u = _conditions(subject), subject.uniforms(ROWS)
    before = condition.clone(), u.clone()
    wo, _ = subject.sample(condition, u)
    wo = wo.clone()
    kept = wo.clone()
    changed = [
        n
        for n, a, b in zip(("condition", "u"), before, (condition, u), strict=True)
        if not torch.equal(a, b)
    ]
    changed = [f"sample changes {name}" for name in changed]
    condition = before[0].clone()
    subject.pdf(condition, wo)
    changed += [] if torch.equal(condition, before[0]) else ["pdf changes condition"]
    changed += [] if torch.equal(wo, kept) else ["pdf changes wo"]
    text = "; ".join(changed) or "no input changed"
    return Finding("inputs-kept", "all", held(not changed), text)


def check_reproducible(subject: Subject) -> Finding:
    """The same uniforms give the same samples, other uniforms others."""
    condition, u = _conditions(subject), subject.uniforms(ROWS)
    first, second = subject.sample(condition, u), subject.sample(condition, u.clone())
    other = subject.sample(condition, subject.uniforms(ROWS))
    name = "same-u"
    if not (torch.equal(first.wo, second.wo) and torch.equal(first.pdf, second.pdf)):
        k = int((first.wo - second.wo).abs().sum(-1).argmax())
        worst = {
            "condition": rounded(condition[k]),
            "u": rounded(u[k]),
            "first": rounded(first.wo[k]),
            "then": rounded(second.wo[k]),
        }
        return Finding(name, "all", "fail", "the same uniforms give different samples", worst)
    same = float((first.wo == other.wo).all(-1).double().mean())
    if same > 0.5:
        text = f"other uniforms give the same direction in {same:.0%} of the rows"
        return Finding(name, "all", "fail", text)
    return Finding(name, "all", "pass", "the same samples twice, others for other uniforms")


def check_rows(subject: Subject) -> Iterator[Finding]:
    """Any batch size and any order of the rows give the same rows."""
    condition, u = _conditions(subject), subject.uniforms(ROWS)
    base = subject.sample(condition, u)
    expected = subject.pdf(condition, base.wo)
    order = torch.randperm(ROWS, generator=subject.generator).to(subject.device)
    picks: dict[str, Tensor] = {
        "0": order[:0],
        "1": order[:1],
        "7": order[:7],
        "513": torch.arange(ROWS - 513, ROWS, device=subject.device),
        "reversed": torch.arange(ROWS - 1, -1, -1, device=subject.device),
    }
    for case, rows in picks.items():
        name = "rows"
        got = subject.sample(condition[rows], u[rows])
        density = subject.pdf(condition[rows], base.wo[rows])
        finding = compare(subject, name, case, condition, u, base, got, rows)
        if finding.ok:
            off = _apart(density, expected[rows])
            if bool(off.any()):
                k = int(off.nonzero()[0, 0])
                worst = {"condition": rounded(condition[rows[k]]), "got": rounded(density[k])}
                finding = Finding(name, case, "fail", "pdf depends on the other rows", worst)
        yield finding


def check_nan_confined(subject: Subject) -> Iterator[Finding]:
    """A row that holds a nan is refused, or spoils no other row."""
    condition, u = _conditions(subject), subject.uniforms(ROWS)
    base = subject.sample(condition, u)
    density = subject.pdf(condition, base.wo)
    hit = ROWS // 3
    rest = torch.arange(ROWS, device=subject.device) != hit

    def spoiled(rows: Tensor) -> Tensor:
        rows = rows.clone()
        rows[hit] = torch.nan
        return rows

    rows = rest.nonzero()[:, 0]
    for case, call in {
        "condition": lambda: subject.sample(spoiled(condition), u),
        "u": lambda: subject.sample(condition, spoiled(u)),
    }.items():
        got = _or_refused(call)
        if isinstance(got, str):
            yield Finding("nan-confined", case, "pass", got)
        else:
            got = DiskSample(got.wo[rest], got.pdf[rest])
            yield compare(subject, "nan-confined", case, condition, u, base, got, rows)
    got = _or_refused(lambda: subject.pdf(condition, spoiled(base.wo)))
    if isinstance(got, str):
        yield Finding("nan-confined", "wo", "pass", got)
    else:
        off = int(_apart(got, density)[rest].sum())
        text = f"{off} other rows differ" if off else "no other row differs"
        yield Finding("nan-confined", "wo", held(off == 0), text)


def check_restored(subject: Subject) -> Finding:
    """State written as safetensors and loaded into a new method gives the same samples."""
    state = subject.method.state_dict()
    restored = copy.deepcopy(subject.blank)
    restored.bind(subject.material)
    restored.load_state_dict(safetensors.torch.load(safetensors.torch.save(state)))
    condition, u = _conditions(subject), subject.uniforms(ROWS)
    base = subject.sample(condition, u)
    rows = torch.arange(ROWS, device=subject.device)
    other = Subject(restored, subject.blank, subject.material, subject.device, subject.generator)
    finding = compare(
        subject, "save-load", "all", condition, u, base, other.sample(condition, u), rows
    )
    off = _apart(other.pdf(condition, base.wo), subject.pdf(condition, base.wo))
    if finding.ok and bool(off.any()):
        text = f"pdf differs after loading in {int(off.sum())} rows"
        return Finding("save-load", "all", "fail", text)
    return finding


def compare(
    subject: Subject,
    name: str,
    case: str,
    condition: Tensor,
    u: Tensor,
    base: DiskSample,
    got: DiskSample,
    rows: Tensor,
) -> Finding:
    """Whether ``got`` are the rows ``rows`` of ``base = sample(condition, u)``.

    The same row may round differently in another batch, and close to an edge of a cdf that
    moves a sample visibly. So rows that differ are compared with what uniforms next to theirs
    give in the original batch.
    """
    off = (got.wo - base.wo[rows]).abs().amax(-1) > TOLERANCE if len(rows) else rows.bool()
    off = off | _apart(got.pdf, base.pdf[rows]) | (got.wo.isnan().any(-1))
    if bool(off.any()):
        off = off & ~_within_rounding(subject, condition, u, base, got, rows)
    if not bool(off.any()):
        return Finding(name, case, "pass", f"{len(rows)} rows as before")
    k = int(off.nonzero()[0, 0])
    worst = {
        "condition": rounded(condition[rows[k]]),
        "u": rounded(u[rows[k]]),
        "got": f"wo {rounded(got.wo[k])} pdf {rounded(got.pdf[k])}",
        "expected": f"wo {rounded(base.wo[rows[k]])} pdf {rounded(base.pdf[rows[k]])}",
    }
    return Finding(name, case, "fail", f"{int(off.sum())} of {len(rows)} rows differ", worst)


def _conditions(subject: Subject) -> Tensor:
    """Rows [ROWS, C] with wi in opposite quadrants, so that frames and signs differ."""
    distinct = subject.conditions(len(QUADRANTS)).clone()
    signs = torch.tensor(QUADRANTS, device=subject.device)
    distinct[:, -2:] = distinct[:, -2:].abs() * signs
    return distinct.repeat_interleave(-(-ROWS // len(QUADRANTS)), 0)[:ROWS].clone()


def _within_rounding(
    subject: Subject,
    condition: Tensor,
    u: Tensor,
    base: DiskSample,
    got: DiskSample,
    rows: Tensor,
) -> Tensor:
    lowest = torch.cat([base.wo, base.pdf[:, None]], 1)
    highest = lowest
    for column in range(3):
        for step in (-U_NUDGE, U_NUDGE):
            near = u.clone()
            # Uniforms stay in [0, 1).
            near[:, column] = (near[:, column] + step).clamp(0, 1 - 2.0**-24)
            wo, pdf = subject.sample(condition, near)
            found = torch.cat([wo, pdf[:, None]], 1)
            lowest, highest = torch.minimum(lowest, found), torch.maximum(highest, found)
    value = torch.cat([got.wo, got.pdf[:, None]], 1)
    slack = TOLERANCE * torch.cat([torch.ones_like(got.wo), got.pdf[:, None].abs()], 1)
    return ((value >= lowest[rows] - slack) & (value <= highest[rows] + slack)).all(-1)


def _apart(a: Tensor, b: Tensor) -> Tensor:
    """Whether densities differ by more than the tolerance; nan differs from everything."""
    return ~((a - b).abs() <= TOLERANCE * torch.maximum(a.abs(), b.abs()))


def _or_refused(call: Callable[[], Tensor | DiskSample]) -> Tensor | DiskSample | str:
    try:
        return call()
    except (InputError, ValueError) as error:
        return f"refused: {error}"
