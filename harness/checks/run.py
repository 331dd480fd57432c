"""Fit a method with a small budget, and run properties on ordinary and on hard cases."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from harness.checks import properties
from harness.checks.approximate_pdf import as_declared
from harness.checks.finding import WORST_FIRST, Finding, verdict
from harness.checks.gradients import watched_gradients
from harness.checks.properties import PER_CASE, PER_METHOD, Found, asked_for
from harness.checks.subject import COSINES, RANDOM_CASES, Case, Subject, cases, stream
from harness.core.protocol.errors import StateRefused, Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, Method
from harness.stats.chisquare import sidak

if TYPE_CHECKING:
    from harness.checks.catalogue import HardCase

__all__ = ["CHECK_BUDGET", "FALSE_ALARM", "fit", "run_case", "run_checks", "verdict"]

CHECK_BUDGET = Budget(steps=120, conditions=64, directions=32, resolution=32, pool=64)
"""Enough to leave the initialisation behind. Correctness must not depend on the fit's quality."""

FALSE_ALARM = 5e-4
"""Probability that a correct adapter fails by chance, all statistical tests together. Half of
one in a thousand, to leave room for the approximations of the tests."""

MANY_CASES = 1000
"""Methods times cases that a suite may have and still keep to ``FALSE_ALARM`` as a whole."""
CASE_ALARM = sidak(FALSE_ALARM, MANY_CASES)
"""The share of it that one method in one hard case has."""

ROWS_PER_CASE = 2
"""Conditions of a hard case, at most."""
ORDINARY = len(COSINES) + RANDOM_CASES
"""Ordinary cases of a material."""

SMALL_IS_WORSE = ("p-value", "efficiency")
"""Units of numbers of which the least is the worst; of the others it is the largest."""


def run_checks(
    method: Method,
    material: Material,
    seed: int = 0,
    *,
    device: str = "cpu",
    budget: Budget = CHECK_BUDGET,
    alpha: float = FALSE_ALARM,
    notify: Callable[[Finding], None] = lambda finding: None,
    only: tuple[str, ...] = (),
) -> list[Finding]:
    """Fit ``method`` to ``material`` and check every property in the ordinary cases.

    Every finding also goes to ``notify``, as it is made. ``alpha`` is the level of all
    statistical tests together, ``only`` the names of the properties wanted (all without).
    An exception that the adapter raises is a failed finding of the property at hand.

    Raises:
        Unsupported: the method does not take this material.
    """
    findings: list[Finding] = []

    def told(found: Iterable[Finding]) -> None:
        for finding in found:
            findings.append(finding)
            notify(finding)

    subject, fitting = fit(method, material, seed, device=device, budget=budget)
    told(finding for finding in fitting if not only or finding.property in only or not finding.ok)
    if subject is not None:
        level = sidak(alpha, max(1, ORDINARY * properties.tests(only)))
        told(ordinary(subject, level, only))
    return findings


def run_case(
    fitted: Method,
    blank: Method,
    material: Material,
    case: HardCase,
    seed: int,
    *,
    device: str = "cpu",
    alpha: float = CASE_ALARM,
) -> list[Finding]:
    """One case of the catalogue, with a ``fitted`` method and one not yet fitted, ``blank``.

    ``material`` is the case's own. ``alpha`` is the level of all statistical tests in the case.
    One finding per property: the worst of the case's conditions.
    """
    subject = Subject(fitted, blank, material, device, stream(seed), seed)
    level = sidak(alpha, max(1, case_tests(case)))
    return list(hard(subject, case, level))


def case_tests(case: HardCase, only: tuple[str, ...] = ()) -> int:
    """Statistical tests in a case of the catalogue, at most."""
    if case.inputs:
        return ORDINARY * properties.tests(only, {case.inputs} & set(PER_CASE))
    return ROWS_PER_CASE * properties.tests(only, case.checks)


def fit(
    method: Method,
    material: Material,
    seed: int = 0,
    *,
    device: str = "cpu",
    budget: Budget = CHECK_BUDGET,
) -> tuple[Subject | None, list[Finding]]:
    """The fitted method as a subject, None if the fit raised; and what was found on the way.

    Raises:
        Unsupported: the method does not take this material.
    """
    supported, reason = method.supports(material)
    if not supported:
        raise Unsupported(reason)
    blank = copy.deepcopy(method)
    with watched_gradients() as watch:
        try:
            generator = stream(seed, material.name, "fit")
            method.fit(material, replace(budget, device=device), generator)
        except Unsupported:
            raise
        except Exception as error:
            return None, [_raised("fit", "all", error)]
    subject = Subject(method, blank, material, device, stream(seed), seed)
    done = Finding("fit", "all", "pass", f"fitted to {material.name}")
    return subject, [done, watch.finding(method)]


def ordinary(subject: Subject, level: float, only: tuple[str, ...] = ()) -> Iterator[Finding]:
    """All properties, or ``only`` those, in the ordinary cases; each test at ``level``."""
    chosen = _ordinary_cases(subject)
    for name in PER_METHOD:
        if asked_for(name, only):
            yield from _of_method(subject, name, chosen)
    for case in chosen:
        yield from _of_case(subject, case, level, _ordinary_properties(), only)


def hard(
    subject: Subject, case: HardCase, level: float, only: tuple[str, ...] = ()
) -> Iterator[Finding]:
    """The properties of a case of the catalogue; each test at ``level``."""
    try:
        altered = _altered(subject, case)
        if altered is None:
            yield Finding("state", case.name, "skip", "the method has no such state")
            return
    except StateRefused as error:
        # No method can be asked to run what it cannot; the number says how far from it this is.
        yield Finding("state", case.name, "degraded", str(error), number=error.number, unit="share")
        return
    except Exception as error:
        yield _raised("state", case.name, error)
        return
    if case.inputs:
        yield from _merged(case.name, list(_inputs(altered, case, level)))
        return
    generator = subject.stream(case.name, "conditions")
    rows = case.conditions(subject.material, generator, subject.device)
    conditions = [Case(f"{case.name}/{k + 1}", row) for k, row in enumerate(rows)]
    # In the order of the table, which is that of cost.
    among = [name for name in PER_CASE if name in case.checks]
    yield from _merged(
        case.name, [f for c in conditions for f in _of_case(altered, c, level, among, only)]
    )


def _altered(subject: Subject, case: HardCase) -> Subject | None:
    """The subject, with the case's state loaded if it has one."""
    if case.alter is None:
        return subject
    state = case.alter(subject.method, subject.stream(case.name, "state"))
    if state is None:
        return None
    method = copy.deepcopy(subject.blank)
    method.bind(subject.material)
    method.load_state_dict({name: value.to(subject.device) for name, value in state.items()})
    return replace(subject, method=method, kept={})


def _inputs(subject: Subject, case: HardCase, level: float) -> Iterator[Finding]:
    """The property that the case is, in the ordinary cases."""
    chosen = _ordinary_cases(subject)
    if case.inputs in PER_METHOD:
        yield from _of_method(subject, case.inputs, chosen)
    else:
        for condition in chosen:
            yield from _of_case(subject, condition, level, (case.inputs,))


def _ordinary_cases(subject: Subject) -> list[Case]:
    return cases(subject.material, subject.stream("cases"), subject.device)


def _ordinary_properties() -> tuple[str, ...]:
    """Without those that are looked at for all ordinary cases at once."""
    return tuple(name for name in PER_CASE if name not in PER_METHOD)


def _of_method(subject: Subject, name: str, chosen: list[Case]) -> Iterator[Finding]:
    mine = replace(subject, generator=subject.stream("all", name))
    return _guarded(name, "all", lambda: PER_METHOD[name](mine, chosen))


def _of_case(
    subject: Subject,
    case: Case,
    level: float,
    among: Iterable[str],
    only: tuple[str, ...] = (),
) -> Iterator[Finding]:
    for name in among:
        if asked_for(name, only):
            mine = replace(subject, generator=subject.stream(case.name, name))
            check = PER_CASE[name].check
            found = _guarded(name, case.name, lambda c=check, s=mine: c(s, case, level))
            yield from (as_declared(subject.method, finding) for finding in found)


def _merged(name: str, found: list[Finding]) -> Iterator[Finding]:
    """Of the findings of each property the worst, under the name of the hard case."""
    for of in dict.fromkeys(finding.property for finding in found):
        worst = min((f for f in found if f.property == of), key=_rank)
        text = worst.text
        if not worst.case.startswith(name) and worst.case != "all":
            text = f"{worst.case}: {text}"
        yield replace(worst, case=name, text=text)


def _rank(finding: Finding) -> tuple[int, float]:
    """Least for the worst: by verdict, then by number."""
    number = 0.0 if finding.number is None or np.isnan(finding.number) else finding.number
    if finding.unit not in SMALL_IS_WORSE:
        number = -number
    return WORST_FIRST.index(finding.verdict), number


def _guarded(name: str, case: str, check: Callable[[], Found]) -> Iterator[Finding]:
    """The findings of a check; an exception is one that fails."""
    try:
        found = check()
        yield from [found] if isinstance(found, Finding) else found
    except Exception as error:
        yield _raised(name, case, error)


def _raised(name: str, case: str, error: Exception) -> Finding:
    text = " ".join(str(error).split())
    return Finding(name, case, "fail", f"raised {type(error).__name__}: {text}")
