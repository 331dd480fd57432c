r"""Weights of a method whose pdf is an approximation: their mean is the albedo.

Such a method gives its estimates itself (:meth:`Method.sample_weighted`); f/p of its pdf says
nothing about them. Their mean is tested against the integral of f by its standard error, which
supposes a variance: the tail index beside it tells whether there is one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from harness.checks.evidence import evidence
from harness.checks.finding import Finding, Verdict, rounded
from harness.checks.reflectance_points import look
from harness.checks.subject import Case, Subject
from harness.checks.weights import (
    INEFFICIENT,
    MOSTLY_INVALID,
    ROUNDING,
    integral_of_f,
    rng_of,
    tail_index,
)
from harness.core.protocol.disk import inside_disk, luminance
from harness.core.protocol.method import Method
from harness.stats.distributions import normal_isf
from harness.stats.weights import efficiency

OF_THE_DENSITY = ("integral", "samples-pdf", "tail", "mitsuba-chi2")
"""Properties that an approximate pdf cannot have."""


def check_approximate_pdf(subject: Subject, case: Case, alpha: float) -> Iterator[Finding]:
    """Findings of the same names as :func:`harness.checks.weights.check_weights`."""
    found = evidence(subject, case)
    wo, _, rgb = subject.method.sample_weighted(found.condition.clone(), found.u.clone())
    weight = luminance(rgb.double()).cpu().numpy()
    share = 1 - float(inside_disk(wo).double().mean())
    verdict: Verdict = "degraded" if share > MOSTLY_INVALID else "pass"
    text = f"{share:.2%} of the samples are off the disk"
    yield Finding("invalid", case.name, verdict, text, number=share)
    if not np.isfinite(weight).all():
        bad = int(np.argmax(~np.isfinite(weight)))
        worst = {"condition": rounded(case.row), "wo": rounded(wo[bad]), "got": rounded(rgb[bad])}
        count = int((~np.isfinite(weight)).sum())
        text = f"{count} of {len(weight)} weights are not finite"
        yield Finding("weights", case.name, "fail", text, worst)
        return
    seen = look(found, rng_of(subject.generator))
    if seen.scale == 0 and not weight.any():
        yield Finding("weights", case.name, "pass", "the material is black here")
        return
    whole = integral_of_f(found, seen, rng_of(subject.generator))
    expected, error = whole.total * seen.scale, whole.error * seen.scale
    mean, spread = float(weight.mean()), float(weight.std(ddof=1)) / math.sqrt(len(weight))
    allowed = normal_isf(alpha / 2) * math.hypot(spread, error) + ROUNDING * expected
    number = efficiency(weight) if mean > 0 else 0.0
    text = f"sample weights: mean {mean:.5g}, albedo {expected:.5g}; efficiency {number:.3g}"
    worst = {}
    verdict = "degraded" if number < INEFFICIENT else "pass"
    if not abs(mean - expected) <= allowed:
        verdict = "fail"
        text = f"sample weights: mean {mean:.5g}, not {expected:.5g} +- {allowed:.2g}"
        worst = {
            "condition": rounded(case.row),
            "got": f"{mean:.6g}",
            "expected": f"{expected:.6g}",
        }
    yield Finding("weights", case.name, verdict, text, worst, number, "efficiency")
    if mean > 0:
        most = float(weight.max()) / mean
        text = f"{most:.3g} times the mean, of {len(weight)} samples"
        yield Finding("largest-weight", case.name, "pass", text, number=most, unit="x mean")
        yield tail_index(case, weight, alpha)


def as_declared(method: Method, finding: Finding) -> Finding:
    """What a method that declares its pdf approximate cannot have is degraded, not wrong."""
    if method.exact_pdf or finding.ok or finding.property not in OF_THE_DENSITY:
        return finding
    text = f"pdf is an approximation, as declared: {finding.text}"
    return replace(finding, verdict="degraded", text=text, worst={})
