"""One outcome of several that were taken apart: the processes of a timing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harness.measures.base import Outcome, Record
from harness.stats.intervals import geometric_mean, mean_interval

_DISTURBED = "disturbed"
_RATIO = "-ratio"


def pooled(outcomes: Sequence[Outcome], tolerance: float, own_times: Sequence[str]) -> Outcome:
    """Their mean, with an interval that says how another process would differ.

    A record that was the same in all, or is in the first alone, stays as it is; others have the
    geometric mean and Student's t over the logs of the values (over the values themselves where
    they are not all positive). Arrays are joined one after another; ``sitting`` [sittings, records]
    has the values that were pooled, nan where a sitting has none.
    ``disturbed`` is 1 where an interval of a ratio to the baseline, or for the baseline of one of
    ``own_times``, is wider than ``tolerance``.

    An outcome that is not a success stands for all.
    """
    for outcome in outcomes:
        if outcome.status != "ok":
            return outcome
    first = [r for r in outcomes[0].records if r.metric != _DISTURBED]
    found = [{r.metric: r.value for r in outcome.records} for outcome in outcomes]
    columns = [[one[r.metric] for one in found if r.metric in one] for r in first]
    records = [_pooled(r, np.array(column)) for r, column in zip(first, columns, strict=True)]
    values = np.array([[one.get(r.metric, np.nan) for r in first] for one in found])
    wide = [
        f"{r.metric} {(r.ci_high - r.ci_low) / r.value:.0%}"
        for r in _decisive(records, own_times)
        if not r.ci_high - r.ci_low <= tolerance * r.value
    ]
    reasons = [outcome.reason for outcome in outcomes if outcome.reason and not disturbed(outcome)]
    if wide:
        many = f"over {len(outcomes)} sittings"
        reasons.append(f"disturbed: interval wider than {tolerance:.0%} {many}: {', '.join(wide)}")
    return Outcome(
        reason="; ".join(dict.fromkeys(reasons)),
        records=[*records, Record(_DISTURBED, float(bool(wide)), unit="1")],
        arrays={
            **{k: _joined(k, outcomes) for k in outcomes[0].arrays},
            "sitting": values,
        },
    )


def _pooled(record: Record, values: np.ndarray) -> Record:
    if (values == values[0]).all():
        return record
    interval = geometric_mean(values) if (values > 0).all() else mean_interval(values)
    return Record(record.metric, *interval, record.unit)


def _joined(name: str, outcomes: Sequence[Outcome]) -> np.ndarray:
    return np.concatenate([np.atleast_1d(o.arrays[name]) for o in outcomes if name in o.arrays])


def _decisive(records: Sequence[Record], own_times: Sequence[str]) -> list[Record]:
    """Ratios to the baseline; the baseline, whose ratios are 1 by definition, has its times."""
    ratios = [r for r in records if r.metric.endswith(_RATIO)]
    compared = [r for r in ratios if r.ci_low < r.ci_high]
    if compared or not ratios:
        return compared
    return [r for r in records if r.metric in own_times]


def disturbed(outcome: Outcome) -> bool:
    """Whether an outcome says that it is."""
    return any(r.metric == _DISTURBED and r.value for r in outcome.records)
