"""The mark on a timing whose interval stayed wide."""

from __future__ import annotations

from collections.abc import Sequence

from harness.analysis.process_pooling import DISTURBED
from harness.core.record import Record
from harness.stats.round_times import RoundTimes


def mark(times: Sequence[RoundTimes], tolerance: float) -> tuple[Record, str]:
    """The record ``disturbed`` for a trial made of ``times``, and its reason.

    1 where an interval is wider than ``tolerance``, its full width over its value.
    """
    wide = [one for one in times if one.wide(tolerance)]
    said = [f"{one.label} {one.width():.0%} after {len(one.seconds)} rounds" for one in wide]
    reason = f"disturbed: interval wider than {tolerance:.0%}: {', '.join(said)}"
    return Record(DISTURBED, float(bool(wide)), unit="1"), reason if wide else ""
