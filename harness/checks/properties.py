"""All properties, by name: those of one case, and those of a method as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from harness.checks import batches, calling, density, devices, distribution, edges, precision
from harness.checks.approximate_pdf import check_approximate_pdf
from harness.checks.finding import Finding
from harness.checks.gradients import check_gradients
from harness.checks.invertible import check_invertible
from harness.checks.subject import Case, Subject
from harness.checks.tail import check_tail
from harness.checks.weights import check_weights

Found = Finding | Iterable[Finding]


@dataclass(frozen=True)
class CaseProperty:
    """A property of one condition: ``check(subject, case, alpha)``.

    ``tests`` statistical tests at level ``alpha`` each; ``also`` are names of further findings.
    """

    check: Callable[[Subject, Case, float], Found]
    tests: int = 0
    also: tuple[str, ...] = ()


def _check_weights(subject: Subject, case: Case, alpha: float) -> Found:
    """Of f/pdf, or of what a method whose pdf is no more than an approximation gives itself."""
    check = check_weights if subject.method.exact_pdf else check_approximate_pdf
    return check(subject, case, alpha)


PER_CASE: dict[str, CaseProperty] = {
    "pdf-finite": CaseProperty(lambda s, c, alpha: density.check_finite_here(s, c)),
    "coverage": CaseProperty(lambda s, c, alpha: density.check_coverage(s, c)),
    "sample-pdf": CaseProperty(lambda s, c, alpha: distribution.check_reported(s, c)),
    "integral": CaseProperty(distribution.check_integral, 1),
    "samples-pdf": CaseProperty(distribution.check_samples, 1),
    "tail": CaseProperty(check_tail, 1),
    "weights": CaseProperty(_check_weights, 2, ("largest-weight", "tail-index", "invalid")),
    "float64": CaseProperty(lambda s, c, alpha: precision.check_float64(s, c)),
    "gradients": CaseProperty(lambda s, c, alpha: check_gradients(s, c)),
    "invertible": CaseProperty(lambda s, c, alpha: check_invertible(s, c)),
}
"""In the order in which they run."""

PER_METHOD: dict[str, Callable[[Subject, list[Case]], Found]] = {
    "inputs-kept": lambda s, cases: calling.check_inputs_kept(s),
    "same-u": lambda s, cases: calling.check_reproducible(s),
    "rows": lambda s, cases: calling.check_rows(s),
    "batch-half-million": lambda s, cases: batches.check_half_million(s),
    "nan-confined": lambda s, cases: calling.check_nan_confined(s),
    "save-load": lambda s, cases: calling.check_restored(s),
    "pdf-finite": density.check_finite,
    "outside-disk": lambda s, cases: edges.check_outside(s),
    "bin-edges": lambda s, cases: edges.check_edges(s),
    "u-corners": density.check_corners,
    "bfloat16": lambda s, cases: precision.check_bfloat16(s),
    "devices": lambda s, cases: devices.check_devices(s),
}
"""``check(subject, ordinary cases)``, deterministic, each once per material."""

FIT = ("fit", "gradients")
"""Names of the findings of the fit itself."""


def names() -> list[str]:
    """Every name a finding of a check may have, sorted."""
    also = [name for item in PER_CASE.values() for name in item.also]
    return sorted({*PER_CASE, *PER_METHOD, *FIT, *also})


def asked_for(name: str, wanted: tuple[str, ...]) -> bool:
    """Whether the property ``name`` runs where only ``wanted`` do; without any, all do."""
    also = PER_CASE[name].also if name in PER_CASE else ()
    return not wanted or any(item in wanted for item in (name, *also))


def tests(wanted: tuple[str, ...] = (), among: Iterable[str] = PER_CASE) -> int:
    """Statistical tests in one case of the properties ``among``, as far as ``wanted``."""
    return sum(PER_CASE[name].tests for name in among if asked_for(name, wanted))
