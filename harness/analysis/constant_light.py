"""Variances that are integrals, in place of those of renders."""

from __future__ import annotations

from dataclasses import replace

from harness.analysis.integral import variance_of
from harness.analysis.pooling import Pooled
from harness.stats.variance import RESOLVED
from harness.store.stored import Stored


def preferred(exact: Stored | None, rendered: Pooled | None) -> Pooled | None:
    """The integral's variance where there is one that is resolved, or that of renders."""
    if exact is None or "sampler" not in exact.arrays:
        return rendered
    found = variance_of(exact.arrays).total
    if found.log is None or found.tail not in RESOLVED:
        return rendered
    if rendered is None:
        return Pooled(found, 0.0, exact=True)
    return replace(rendered, variance=found, exact=True)
