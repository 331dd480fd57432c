"""Do two runs of a suite agree: do the intervals of what both measured overlap, how wide are they?

Two 95 % intervals of equal width from independent measurements of one quantity are apart in
about 6 of 1000 cases; intervals that are apart more often are too narrow, or the machine was not
the same in both runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from harness.analysis import numbers
from harness.analysis.results import Results
from harness.core.protocol.errors import InputError, nearest
from harness.store.stored import LABELS

_KEY = [*(label for label in LABELS if label != "suite"), "metric"]


@dataclass(frozen=True)
class Agreement:
    """One metric of one measure over all that both runs have of it.

    ``pairs`` is the number of intervals compared, ``overlapping`` that of those with a point in
    common; ``width`` is the median and ``widest`` the largest width over its value, of both
    runs. ``apart`` names those that do not overlap.
    """

    measure: str
    metric: str
    pairs: int
    overlapping: int
    width: float
    widest: float
    apart: tuple[str, ...]

    def lines(self) -> list[str]:
        """As text."""
        said = (
            f"{self.measure} {self.metric}: {self.overlapping} of {self.pairs} intervals overlap; "
            f"widths {self.width:.1%} (median), {self.widest:.1%} (widest)"
        )
        return [said, *(f"  apart    {one}" for one in self.apart)]


def compare(
    first: str | Path, second: str | Path, metrics: tuple[str, ...] = ()
) -> tuple[list[Agreement], list[str]]:
    """What both runs measured with an interval, metric by metric; and what was left out, and why.

    ``metrics`` restricts it. A time is compared only where both runs took it on one machine, and
    a number that both runs share because one copied the other's trial is not compared at all.

    Raises:
        InputError: no results there, an unknown metric, or nothing to compare.
    """
    frames = [_with_intervals(folder) for folder in (first, second)]
    known = sorted({*frames[0]["metric"]} & {*frames[1]["metric"]})
    for metric in metrics:
        if metric not in known:
            hint = nearest(metric, known)
            raise InputError(f"--metric: both runs have no intervals of '{metric}'{hint}")
    both = frames[0].merge(frames[1], on=_KEY, suffixes=("", "_again"))
    if metrics:
        both = both[both["metric"].isin(metrics)]
    left_out = []
    copied = (both["trial"] == both["trial_again"]) & (both["started"] == both["started_again"])
    if copied.any():
        left_out.append(f"{int(copied.sum())} numbers are of one and the same run")
    timed = both["machine"] != ""
    elsewhere = timed & (both["machine"] != both["machine_again"])
    if elsewhere.any():
        left_out.append(f"{int(elsewhere.sum())} times were taken on different machines")
    both = both[~copied & ~elsewhere]
    if both.empty:
        why = f" ({'; '.join(left_out)})" if left_out else ""
        raise InputError(f"{first} and {second}: nothing to compare{why}")
    groups = both.groupby(["measure", "metric"], sort=False)
    return [_agreement(*key, rows) for key, rows in groups], left_out


def _agreement(measure: str, metric: str, rows: pd.DataFrame) -> Agreement:
    overlap = (rows["ci_low"] <= rows["ci_high_again"]) & (rows["ci_low_again"] <= rows["ci_high"])
    widths = pd.concat(
        [
            (rows[f"ci_high{run}"] - rows[f"ci_low{run}"]) / rows[f"value{run}"].abs()
            for run in ("", "_again")
        ]
    )
    apart = tuple(
        f"{_where(row)}: {_number(row, '')} and {_number(row, '_again')}"
        for row in rows[~overlap].to_dict("records")
    )
    return Agreement(
        measure,
        metric,
        len(rows),
        int(overlap.sum()),
        float(widths.median()),
        float(widths.max()),
        apart,
    )


def _with_intervals(folder: str | Path) -> pd.DataFrame:
    """Records with an interval of some width (a definition has none), and where each comes from."""
    results = Results.load(folder)
    frame = results.frame
    frame = frame[(frame["status"] == "ok") & (frame["ci_low"] < frame["ci_high"])].copy()
    trials = {trial: results.stored(trial) for trial in frame["trial"].unique()}
    frame["started"] = [trials[trial].started for trial in frame["trial"]]
    frame["machine"] = [str(trials[trial].trial.get("machine") or "") for trial in frame["trial"]]
    return frame


def _where(row: dict[str, object]) -> str:
    parts = [row["method"], row["material"], row["scene"], f"seed {row['seed']}"]
    return " · ".join(str(part) for part in parts if part != "")


def _number(row: dict[str, object], run: str) -> str:
    value, interval = numbers.with_interval(*(row[f"{k}{run}"] for k in _ENDS))
    return f"{value} {interval}"


_ENDS = ("value", "ci_low", "ci_high")
