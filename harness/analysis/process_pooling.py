"""One trial's numbers from a timing that was repeated in fresh processes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import geometric_mean, mean_interval

DISTURBED = "disturbed"
PROCESSES = "processes"
_RATIO = "-ratio"
_PREFIX = re.compile(r"p(\d+)/(.+)")


def together(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Arrays (or documents) of all processes in one mapping, under ``p0/NAME``, ``p1/NAME``, ..."""
    return {f"p{i}/{name}": value for i, part in enumerate(parts) for name, value in part.items()}


def split(raw: Raw) -> list[Raw] | None:
    """Each process's raw data; None where they are of one process alone."""
    arrays, documents = _split(raw.arrays), _split(raw.documents)
    if not arrays:
        return None
    return [Raw(arrays[i], documents.get(i, {}), raw.settings) for i in sorted(arrays)]


def joined(arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Arrays of repeated processes by their own names, one process after another.

    :data:`PROCESSES` [processes] are the numbers of the processes. Arrays of one process come back
    as they are.
    """
    parts = _split(arrays)
    if not parts:
        return dict(arrays)
    found: dict[str, list[NDArray]] = {}
    for i in sorted(parts):
        for name, array in parts[i].items():
            found.setdefault(name, []).append(np.atleast_1d(array))
    return {
        **{name: np.concatenate(each) for name, each in found.items()},
        PROCESSES: np.array(sorted(parts)),
    }


def pooled(
    processes: Sequence[Numbers], tolerance: float, own_times: Sequence[str] = ()
) -> Numbers:
    """Their mean, with an interval that says how another process would differ.

    A record that was the same in all, or is in the first alone, stays as it is; others have the
    geometric mean and Student's t over the logs of the values (over the values themselves where
    they are not all positive). ``disturbed`` is 1 where an interval of a ratio to the baseline, or
    for the baseline of one of ``own_times``, is wider than ``tolerance``.
    """
    first = [r for r in processes[0].records if r.metric != DISTURBED]
    found = [{r.metric: r.value for r in numbers.records} for numbers in processes]
    columns = [[one[r.metric] for one in found if r.metric in one] for r in first]
    records = [_pooled(r, np.array(column)) for r, column in zip(first, columns, strict=True)]
    wide = [
        f"{r.metric} {(r.ci_high - r.ci_low) / r.value:.0%}"
        for r in _decisive(records, own_times)
        if not r.ci_high - r.ci_low <= tolerance * r.value
    ]
    # That one process was disturbed is no news of all; what else there is to say stays.
    said = [part for one in processes for part in one.reason.split("; ")]
    reasons = [part for part in said if part and not part.startswith(DISTURBED)]
    if wide:
        many = f"over {len(processes)} processes"
        reasons.append(f"disturbed: interval wider than {tolerance:.0%} {many}: {', '.join(wide)}")
    records.append(Record(DISTURBED, float(bool(wide)), unit="1"))
    return Numbers(records, "; ".join(dict.fromkeys(reasons)))


def disturbed(numbers: Numbers) -> bool:
    """Whether one of the intervals that count stayed wider than the tolerance."""
    return any(r.metric == DISTURBED and r.value for r in numbers.records)


def _split(named: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    found: dict[int, dict[str, Any]] = {}
    for key, value in named.items():
        if match := _PREFIX.fullmatch(key):
            found.setdefault(int(match[1]), {})[match[2]] = value
    return found


def _pooled(record: Record, values: NDArray) -> Record:
    if (values == values[0]).all():
        return record
    interval = geometric_mean(values) if (values > 0).all() else mean_interval(values)
    return Record(record.metric, *interval, record.unit)


def _decisive(records: Sequence[Record], own_times: Sequence[str]) -> list[Record]:
    """Ratios to the baseline; the baseline, whose ratios are 1 by definition, has its times."""
    ratios = [r for r in records if r.metric.endswith(_RATIO)]
    compared = [r for r in ratios if r.ci_low < r.ci_high]
    if compared or not ratios:
        return compared
    return [r for r in records if r.metric in own_times]
