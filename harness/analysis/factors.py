"""Speed-ups of a results folder from all renders of each cell, not the timed ones alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from harness.analysis import constant_light, pooling
from harness.analysis.pooling import Factor, Pooled
from harness.analysis.process_pooling import PROCESSES, joined
from harness.store.stored import Stored

SAME_SPP, TIMED, EXACT = "equal-spp", "equal-time", "constant-light"
EQUAL_TIME, EQUAL_SPP = "speedup-equal-time", "speedup-equal-spp"

Cell = tuple[str, str, str, int]
"""Material, method, scene, seed."""


@dataclass
class Factors:
    """What was pooled: ``trials`` with their new records, and ``found`` by trial and metric."""

    trials: dict[str, Stored]
    found: dict[tuple[str, str], Factor] = field(default_factory=dict)
    undiagnosed: set[str] = field(default_factory=set)
    """Timed trials whose speed-ups are as recorded: nothing was stored to pool."""

    def kinds(self, trials: Iterable[str]) -> str:
        """How many speed-ups of these trials have tails of which class, in words."""
        found = [self.found[key, EQUAL_SPP] for key in trials if (key, EQUAL_SPP) in self.found]
        heavy = sum(one.heavy and one.resolved for one in found)
        lost = sum(not one.resolved for one in found)
        exact = sum(one.exact for one in found)
        counts = {"light": len(found) - heavy - lost, "heavy": heavy, "not resolved": lost}
        said = [f"{count} {name}" for name, count in counts.items() if count]
        if exact:
            said.append(f"{exact} of variances that are integrals, exact but for the quadrature")
        return ", ".join(said)


def pooled(plan: Mapping[str, Any], trials: Mapping[str, Stored], baseline: str) -> Factors:
    """All timed trials of the plan with speed-ups over ``baseline`` (its label) by all renders."""
    result = Factors(dict(trials))
    cells = _cells(plan, trials)
    variances: dict[Cell, Pooled | None] = {}

    def variance(cell: Cell) -> Pooled | None:
        if cell not in variances:
            at = cells.get(cell, {})
            variances[cell] = constant_light.preferred(
                at.get(EXACT), pooling.variance_of(at.get(SAME_SPP), at.get(TIMED))
            )
        return variances[cell]

    for (material, method, scene, seed), at in cells.items():
        timed, same_spp = at.get(TIMED), at.get(SAME_SPP)
        if method == baseline:
            continue
        base = variance((material, baseline, scene, seed))
        own = variance((material, method, scene, seed))
        ratio = pooling.variance_ratio(base, own) if base and own else None
        if same_spp is not None and ratio is not None:
            result.found[same_spp.hash, EQUAL_SPP] = ratio
        if timed is None or "seconds" not in timed.arrays:
            continue
        arrays = joined(timed.arrays)
        if ratio is None or PROCESSES in arrays:
            if not (base and own) and "compared" in arrays:
                result.undiagnosed.add(timed.hash)
            continue
        times = (arrays["baseline_seconds"], arrays["seconds"])
        made = {EQUAL_SPP: ratio, EQUAL_TIME: pooling.speed_up(ratio, *times)}
        result.trials[timed.hash] = _with(timed, made)
        result.found |= {(timed.hash, metric): factor for metric, factor in made.items()}
    return result


def _cells(plan: Mapping[str, Any], trials: Mapping[str, Stored]) -> dict[Cell, dict[str, Stored]]:
    cells: dict[Cell, dict[str, Stored]] = {}
    for row in plan["trials"]:
        trial = trials.get(row["trial"])
        wanted = row["measure"] in (SAME_SPP, TIMED, EXACT)
        if wanted and trial is not None and trial.status == "ok":
            cell = (row["material"], row["method"], row["scene"], row["seed"])
            cells.setdefault(cell, {})[row["measure"]] = trial
    return cells


def _with(trial: Stored, made: Mapping[str, Factor]) -> Stored:
    """The trial with records of the ``made`` in place of its own."""
    records = []
    for record in trial.records:
        if record["metric"] in made:
            value, low, high = made[record["metric"]].interval
            high = high if math.isfinite(high) else math.nan
            record = {**record, "value": value, "ci_low": low, "ci_high": high}
        records.append(record)
    return replace(trial, records=records)
