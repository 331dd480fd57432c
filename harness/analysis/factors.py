"""Speed-ups of a results folder from all renders of each cell, not the timed ones alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from harness.analysis import constant_light, pooling
from harness.analysis.pooling import Factor, Pooled
from harness.analysis.process_pooling import PROCESSES, joined
from harness.core.workers import together
from harness.store.stored import Stored

SAME_SPP, TIMED, EXACT = "equal-spp", "equal-time", "constant-light"
EQUAL_TIME, EQUAL_SPP = "speedup-equal-time", "speedup-equal-spp"

Cell = tuple[str, str, str, int]
"""Material, method, scene, seed."""
Cells = Mapping[Cell, Mapping[str, Stored]]
"""Their trials by measure."""
_MANY, _SHARES = 64, 8
"""Cells that are worth a process, and how many parts they are divided into."""


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
    cells = _cells(plan, trials)
    # Those of one material, scene and seed share a baseline, and nothing with others.
    contests: dict[tuple, dict[Cell, Mapping[str, Stored]]] = {}
    for cell, at in cells.items():
        material, _, scene, seed = cell
        contests.setdefault((material, scene, seed), {})[cell] = at
    count = _SHARES if len(cells) >= _MANY else 1
    shares = [list(contests.values())[first::count] for first in range(count)]
    made = together({str(n): partial(_factors, share, baseline) for n, share in enumerate(shares)})
    result = Factors(dict(trials))
    for found, undiagnosed in made.values():
        result.found |= found
        result.undiagnosed |= undiagnosed
    for at in cells.values():
        if (timed := at.get(TIMED)) is not None and (timed.hash, EQUAL_TIME) in result.found:
            own = {name: result.found[timed.hash, name] for name in (EQUAL_SPP, EQUAL_TIME)}
            result.trials[timed.hash] = _with(timed, own)
    return result


def _factors(
    contests: Iterable[Cells], baseline: str
) -> tuple[dict[tuple[str, str], Factor], set[str]]:
    """``found`` and ``undiagnosed`` of :class:`Factors`, of cells of each contest."""
    found: dict[tuple[str, str], Factor] = {}
    undiagnosed: set[str] = set()
    for cells in contests:
        variances = {cell: _variance(at) for cell, at in cells.items()}
        for cell, at in cells.items():
            material, method, scene, seed = cell
            if method != baseline:
                base = variances.get((material, baseline, scene, seed))
                _compare(at, base, variances[cell], found, undiagnosed)
    return found, undiagnosed


def _variance(at: Mapping[str, Stored]) -> Pooled | None:
    rendered = pooling.variance_of(at.get(SAME_SPP), at.get(TIMED))
    return constant_light.preferred(at.get(EXACT), rendered)


def _compare(
    at: Mapping[str, Stored],
    base: Pooled | None,
    own: Pooled | None,
    found: dict[tuple[str, str], Factor],
    undiagnosed: set[str],
) -> None:
    """Add to ``found`` or ``undiagnosed`` what one cell comes to."""
    timed, same_spp = at.get(TIMED), at.get(SAME_SPP)
    ratio = pooling.variance_ratio(base, own) if base and own else None
    if same_spp is not None and ratio is not None:
        found[same_spp.hash, EQUAL_SPP] = ratio
    if timed is None or "seconds" not in timed.arrays:
        return
    arrays = joined(timed.arrays)
    if ratio is None or PROCESSES in arrays:
        if not (base and own) and "compared" in arrays:
            undiagnosed.add(timed.hash)
        return
    times = (arrays["baseline_seconds"], arrays["seconds"])
    found[timed.hash, EQUAL_SPP] = ratio
    found[timed.hash, EQUAL_TIME] = pooling.speed_up(ratio, *times)


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
