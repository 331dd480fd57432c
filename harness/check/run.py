"""Fit a method with a small budget and run every property on it."""

from __future__ import annotations

import copy
import zlib
from collections.abc import Callable, Iterable, Iterator

import torch

from harness.check.calling import (
    check_inputs_kept,
    check_nan_confined,
    check_reproducible,
    check_restored,
    check_rows,
)
from harness.check.density import check_corners, check_coverage, check_finite
from harness.check.distribution import TESTS, check_distribution
from harness.check.finding import Finding
from harness.check.subject import Case, Subject, cases
from harness.protocol import Budget, Material, Method, Unsupported
from harness.stats.chisquare import sidak

CHECK_BUDGET = Budget(steps=120, conditions=64, directions=32, resolution=32, pool=256)
"""Enough to leave the initialisation behind. Correctness must not depend on the fit's quality."""

FALSE_ALARM = 5e-4
"""Probability that a correct adapter fails by chance, all statistical tests together. Half of
one in a thousand, to leave room for the approximations of the tests."""


def run_checks(
    method: Method,
    material: Material,
    seed: int = 0,
    *,
    device: str = "cpu",
    budget: Budget = CHECK_BUDGET,
    alpha: float = FALSE_ALARM,
    notify: Callable[[Finding], None] = lambda finding: None,
) -> list[Finding]:
    """Check ``method``, not fitted yet, on ``material``; every finding also goes to ``notify``.

    An exception that the adapter raises is a failed finding of the property at hand.

    Raises:
        Unsupported: the method does not take this material.
    """
    supported, reason = method.supports(material)
    if not supported:
        raise Unsupported(reason)
    findings: list[Finding] = []
    for finding in _findings(method, material, seed, device, budget, alpha):
        findings.append(finding)
        notify(finding)
    return findings


def _findings(
    method: Method, material: Material, seed: int, device: str, budget: Budget, alpha: float
) -> Iterator[Finding]:
    # Another material, other random numbers: two tests of one seed are to be independent.
    generator = torch.Generator().manual_seed(seed + zlib.crc32(material.name.encode()))
    blank = copy.deepcopy(method)
    budget = Budget(**{**vars(budget), "device": device})
    try:
        method.fit(material, budget, generator)
    except Unsupported:
        raise
    except Exception as error:
        yield _raised("fit", "all", error)
        return
    subject = Subject(method, blank, material, device, generator)
    chosen = cases(material, generator, device)
    level = sidak(alpha, TESTS * len(chosen))
    yield from _guarded("inputs-kept", "all", lambda: [check_inputs_kept(subject)])
    yield from _guarded("same-u", "all", lambda: [check_reproducible(subject)])
    yield from _guarded("rows", "all", lambda: check_rows(subject))
    yield from _guarded("nan-confined", "all", lambda: check_nan_confined(subject))
    yield from _guarded("save-load", "all", lambda: [check_restored(subject)])
    yield from _guarded("pdf-finite", "all", lambda: [check_finite(subject, chosen)])
    yield from _guarded("u-corners", "all", lambda: [check_corners(subject, chosen)])
    for case in chosen:
        yield from _per_case(subject, case, level)


def _per_case(subject: Subject, case: Case, level: float) -> Iterator[Finding]:
    yield from _guarded("coverage", case.name, lambda: [check_coverage(subject, case)])
    yield from _guarded("distribution", case.name, lambda: check_distribution(subject, case, level))


def _guarded(name: str, case: str, check: Callable[[], Iterable[Finding]]) -> Iterator[Finding]:
    try:
        yield from check()
    except Exception as error:
        yield _raised(name, case, error)


def _raised(name: str, case: str, error: Exception) -> Finding:
    text = " ".join(str(error).split())
    return Finding(name, case, False, f"raised {type(error).__name__}: {text}")
