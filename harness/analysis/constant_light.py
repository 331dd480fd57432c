"""Variances that are integrals, in place of those of renders."""

from __future__ import annotations

from harness.analysis.integral import variance_of
from harness.analysis.pooling import Pooled
from harness.stats.variance import RESOLVED, contradict
from harness.store.stored import Stored


def preferred(exact: Stored | None, rendered: Pooled | None) -> Pooled | None:
    """The integral's variance where it is resolved, or that of renders.

    Where renders with a light tail say something else, by more than three standard errors of both,
    ``doubt`` has it.
    """
    if exact is None or "sampler" not in exact.arrays:
        return rendered
    integral = variance_of(exact.arrays)
    found = integral.total
    if found.log is None or found.tail not in RESOLVED:
        return rendered
    spp = 0.0 if rendered is None else rendered.spp
    doubt = ""
    if rendered is not None and rendered.variance.tail in RESOLVED:
        other = rendered.variance
        if other.log is not None and contradict(found, other):
            low, high = other.log.interval[1:]
            doubt = f"integral {found.value:.3g}, renders {other.value:.3g} [{low:.3g}, {high:.3g}]"
    # No samples of a batch: such points pair with no renders.
    return Pooled(found, spp, integral.points, integral.pixels, 0, exact=True, doubt=doubt)
