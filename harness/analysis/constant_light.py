"""Variances that are integrals, in place of those of renders."""

from __future__ import annotations

import numpy as np

from harness.analysis.integral import variance_of
from harness.analysis.pooling import Pooled
from harness.stats.variance import RESOLVED
from harness.store.stored import Stored

WORTH = 1.1
"""Ends of an integral that are closer are taken, whatever the renders say."""


def preferred(exact: Stored | None, rendered: Pooled | None) -> Pooled | None:
    """The integral's variance where it is resolved and not the wider one, or that of renders."""
    if exact is None or "sampler" not in exact.arrays:
        return rendered
    integral = variance_of(exact.arrays)
    found = integral.total
    if found.log is None or found.tail not in RESOLVED:
        return rendered
    if rendered is not None and found.log.factor > max(WORTH, rendered.variance_factor):
        return rendered
    pixels = np.ones(integral.points.shape[1])
    spp = 0.0 if rendered is None else rendered.spp
    # No samples of a batch: such points pair with no renders.
    return Pooled(found, spp, integral.points, pixels, batch_spp=0, exact=True)
