"""What is stored, as tables and figures ask for it: by material, method, scene and measure."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from harness.analysis.combine import Estimate
from harness.analysis.factors import Factors, pooled
from harness.analysis.pooling import Factor
from harness.analysis.process_pooling import joined
from harness.analysis.renew import renewed
from harness.analysis.seeds import over_training_seeds, training_seeds
from harness.analysis.shares import between, between_all
from harness.analysis.validity import changed, changed_files, in_few_words
from harness.store.damage import damage
from harness.store.folder import ResultsFolder
from harness.store.frame import STALE, frame
from harness.store.stored import LABELS, NOT_RUN, Stored

T = TypeVar("T")

SHOWN = ("ok", STALE)
"""Statuses of rows with a number; that of a stale one is printed with its reason."""
NO_TRIAL = "not planned: the suite has no such trial"
CEILING = "tabulated"
"""The method that is shown, but is too slow and too large to win."""


@dataclass(frozen=True)
class MethodColumn:
    """A method as a table's column: its label, and the registry name behind it."""

    label: str
    name: str

    @property
    def ceiling(self) -> bool:
        return self.name == CEILING


@dataclass
class Results:
    """The records of one results folder, and its raw outputs when asked for.

    ``frame`` has a row per record, in the suite's order (:func:`harness.store.frame.frame`);
    ``plan`` is that of the last run, ``found`` the stored trials by key.
    """

    folder: Path
    frame: pd.DataFrame
    plan: dict[str, Any]
    found: dict[str, Stored] = field(default_factory=dict)
    whole: pd.DataFrame | None = None
    """Where ``frame`` is a part that is to be shown: all rows."""
    factors: Factors = field(default_factory=lambda: Factors({}))
    """Speed-ups from all renders of each cell."""
    earlier: frozenset[str] = frozenset()
    """Fits that came with the harness, made by an earlier version of the code."""

    @classmethod
    def load(cls, folder: str | Path, all: bool = False) -> Results:
        """What is stored, its records as today's analysis makes them, stale ones marked."""
        with ResultsFolder(folder) as store, store.as_it_is():
            plan, trials = store.plan(), store.trials()
            damaged = damage(store, trials).items()
            trials |= {key: _damaged(trials[key], why) for key, why in damaged if key in trials}
            if lost := store.lost():
                trials |= _lost(plan, trials, lost)
            trials = {key: renewed(trial) for key, trial in trials.items()}
            code = changed(store, trials)
        old = code.stale | changed_files(plan)
        # No database is open here: it may be shared among processes.
        found = pooled(plan, trials, baseline_of(plan))
        table = between_all(frame(plan["trials"], found.trials, old, all))
        earlier = code.earlier & set(table["trial"])
        return cls(Path(folder), table, plan, found.trials, factors=found, earlier=earlier)

    def restricted(self, allowed: Mapping[str, Collection[str]]) -> Results:
        """The part with these labels by column; a column that is not named is not restricted.

        What is shown is restricted, not what it is compared with, such as the baseline.
        """
        keep = np.ones(len(self.frame), bool)
        for column, values in allowed.items():
            keep &= self.frame[column].isin(values).to_numpy()
        return replace(self, frame=self.frame[keep], whole=self._whole)

    # --- what there is, in the suite's order -------------------------------------------------

    @cached_property
    def methods(self) -> list[MethodColumn]:
        """The suite's order, the ceiling last."""
        names = {row["method"]: _registry_name(row) for row in self.plan["trials"]}
        columns = [MethodColumn(label, names[label]) for label in self._values("method")]
        return sorted(columns, key=lambda column: column.ceiling)

    @cached_property
    def materials(self) -> list[str]:
        return self._values("material")

    def scenes(self, measure: str) -> list[str]:
        """Scenes in which the measure is taken; [""] for a measure without one."""
        return list(dict.fromkeys(self.frame.loc[self.frame["measure"] == measure, "scene"]))

    def has(self, measure: str) -> bool:
        """Whether the suite asks for the measure (its trials may all have failed)."""
        return bool((self.frame["measure"] == measure).any())

    @cached_property
    def baseline(self) -> str:
        """Label of the reference method; "" if the suite names none."""
        return baseline_of(self.plan)

    @property
    def title(self) -> str:
        return str(self.plan.get("title") or self.plan.get("suite") or self.folder.name)

    @property
    def profile(self) -> str:
        """Name of the profile that was run; "" if the suite has none."""
        return str(self.plan.get("profile") or "")

    def wanted(self, kind: str) -> list[str] | None:
        """Names under the suite's ``report: {tables, figures}``; None if it does not say."""
        names = (self.plan.get("report") or {}).get(kind)
        return None if names is None else [str(name) for name in names]

    # --- one number --------------------------------------------------------------------------

    def rows(
        self,
        measure: str,
        material: str | None = None,
        method: str | None = None,
        scene: str | None = None,
    ) -> list[dict[str, Any]]:
        """All rows of these trials; None stands for any."""
        found = self._index.get((measure, material, method), [])
        return found if scene is None else [row for row in found if row["scene"] == scene]

    def number(
        self, measure: str, metric: str, material: str, method: str, scene: str = ""
    ) -> Estimate | str:
        """The number over all seeds, or the reason why there is none.

        If some seeds failed it is that of the others, with a note; so has one that is stale.
        """
        rows = self.rows(measure, material, method, scene)
        if not rows:
            return NO_TRIAL
        found = [
            row
            for row in rows
            if row["metric"] == metric
            and row["status"] in SHOWN
            and not (math.isnan(row["value"]) or _one_sided(row))
        ]
        factors = [self.factors.found.get((row["trial"], metric)) for row in rows]
        unresolved = [f for f in factors if f is not None and not f.resolved]
        if not found:
            bound = _not_resolved(unresolved) or _bounded(rows, metric)
            return bound or _why(rows, measure, metric)
        number = between(metric, over_training_seeds(self._by_training(found)))
        said = dict.fromkeys(f.note for f in factors if f is not None and f.note)
        if said:
            number = replace(number, note="; ".join(filter(None, [number.note, *said])))
        old = next((str(row["reason"]) for row in found if row["status"] == STALE), "")
        if old:
            number = replace(number, note=in_few_words(old))
        good = {row["trial"] for row in found}
        seeds = {row["trial"] for row in rows}
        if good != seeds:
            lost = _not_resolved(unresolved) or _why(
                [row for row in rows if row["trial"] not in good], measure, metric
            )
            few = f"{len(good)} of {len(seeds)} seeds only; {lost}"
            return replace(number, note="; ".join(filter(None, (number.note, few))))
        return number

    def by_training(
        self, measure: str, metric: str, material: str, method: str, scene: str = ""
    ) -> dict[int, list[Estimate]]:
        """The numbers by the seed of the fit that they were measured with."""
        return self._by_training(
            row
            for row in self.rows(measure, material, method, scene)
            if row["metric"] == metric
            and row["status"] in SHOWN
            and not (math.isnan(row["value"]) or _one_sided(row))
        )

    def factor(self, found: Mapping[str, Factor]) -> Estimate | str:
        """The speed-up over all seeds of those of trials, by key; or why there is none."""
        resolved = {key: one for key, one in found.items() if one.resolved}
        if not resolved:
            return _not_resolved(list(found.values()))
        fits: dict[int, list[Estimate]] = {}
        for key, one in resolved.items():
            fits.setdefault(self.training.get(key, 0), []).append(Estimate(*one.interval))
        number = over_training_seeds(fits)
        notes = dict.fromkeys(one.note for one in found.values() if one.note)
        return replace(number, note="; ".join(filter(None, [number.note, *notes])))

    def why_missing(self, measure: str, material: str, method: str, scene: str = "") -> str:
        """Why there is no such trial that ended well."""
        rows = self.rows(measure, material, method, scene)
        return _why(rows, measure, "") if rows else NO_TRIAL

    # --- raw outputs -------------------------------------------------------------------------

    def trials(
        self,
        measure: str,
        material: str | None = None,
        method: str | None = None,
        scene: str | None = None,
    ) -> list[str]:
        """Hashes of the trials with a number, in the suite's order."""
        rows = self.rows(measure, material, method, scene)
        return list(dict.fromkeys(row["trial"] for row in rows if row["status"] in SHOWN))

    def stale(self, measure: str) -> tuple[int, int]:
        """How many trials of a measure have numbers that do not hold any more, and of how many."""
        rows = self.rows(measure)
        old = {row["trial"] for row in rows if row["status"] == STALE}
        return len(old), len({row["trial"] for row in rows})

    def stored(self, trial: str) -> Stored:
        """A trial with its arrays and images."""
        if trial in self.found:
            return self.found[trial]
        row = next(row for row in self.plan["trials"] if row["trial"] == trial)
        labels = {key: row[key] for key in LABELS}
        return Stored(trial, row["identity"], labels, "skipped", NOT_RUN)

    def arrays(self, trial: str) -> dict[str, np.ndarray]:
        """The raw arrays of a trial; those of repeated processes one after another."""
        return joined(self.stored(trial).arrays)

    def counts(self, measure: str, name: str) -> str:
        """Length of an array over all trials of a measure, as "8" or "8 to 12"; "" if none."""
        lengths = {
            len(arrays[name])
            for trial in self.trials(measure)
            if name in (arrays := self.arrays(trial))
        }
        if len(lengths) < 2:
            return "".join(map(str, lengths))
        return f"{min(lengths)} to {max(lengths)}"

    def once(self, function: Callable[..., T], *at: str) -> T:
        """``function(self, *at)``, asked for once: table and figure draw the same resamples."""
        if (function, at) not in self._made:
            self._made[function, at] = function(self, *at)
        return self._made[function, at]

    @cached_property
    def training(self) -> dict[str, int]:
        """The training seed of every planned trial."""
        return training_seeds(self.plan["trials"])

    # --- inside ------------------------------------------------------------------------------

    @property
    def _whole(self) -> pd.DataFrame:
        return self.frame if self.whole is None else self.whole

    @cached_property
    def _made(self) -> dict[tuple[Callable, tuple[str, ...]], Any]:
        return {}

    @cached_property
    def _index(self) -> dict[tuple[str, str | None, str | None], list[dict[str, Any]]]:
        """Rows by (measure, material, method), and by those with None for any."""
        index: dict[tuple[str, str | None, str | None], list[dict[str, Any]]] = {}
        for row in self._whole.to_dict("records"):
            for material in (row["material"], None):
                for method in (row["method"], None):
                    index.setdefault((row["measure"], material, method), []).append(row)
        return index

    def _by_training(self, rows: Iterable[dict[str, Any]]) -> dict[int, list[Estimate]]:
        found: dict[int, list[Estimate]] = {}
        for row in rows:
            # Trials of earlier plans, which are shown on request, stand for themselves.
            seed = self.training.get(row["trial"], row["seed"])
            found.setdefault(seed, []).append(_estimate(row))
        return found

    def _values(self, column: str) -> list[str]:
        return list(dict.fromkeys(self.frame[column]))


def load_results(folder: str | Path, all: bool = False) -> pd.DataFrame:
    """A row per record of a results folder, at least one per planned trial.

    Columns: suite, material, method, scene, measure, metric, value, ci_low, ci_high (of a 95 %
    interval, nan where there is none), unit, seed, status, reason, trial. ``status`` is ``ok``,
    or ``skipped``, ``unsupported``, ``timeout``, ``error``, ``nonfinite``, ``stale`` with its
    ``reason``. With ``all``, trials of earlier plans follow.

    Raises:
        InputError: no results there, or of another format.
    """
    return Results.load(folder, all).frame


def baseline_of(plan: Mapping[str, Any]) -> str:
    """Label of the reference method of a plan; "" if it names none."""
    name = str(plan.get("baseline") or "")
    rows = plan["trials"]
    return next((r["method"] for r in rows if name in (r["method"], _registry_name(r))), name)


def _not_resolved(factors: list[Factor]) -> str:
    """Why a speed-up has no number, with its one-sided bound; "" where that is not why."""
    if not factors:
        return ""
    said = f"not resolved: {factors[0].bound}×" if factors[0].bound else "not resolved"
    return f"{said}; {factors[0].note}" if factors[0].note else said


def _one_sided(row: Mapping[str, Any]) -> bool:
    """Whether nothing bounds the number from above: a lower bound is all there is."""
    return math.isnan(row["ci_high"]) and not math.isnan(row["ci_low"])


def _bounded(rows: list[dict[str, Any]], metric: str) -> str:
    """Why a number with a lower bound alone is none; "" where there is no such."""
    found = [row for row in rows if row["metric"] == metric and _one_sided(row)]
    if not found:
        return ""
    low = min(row["ci_low"] for row in found)
    return f"not resolved: at least {low:.3g}, the tail allows any more"


def _damaged(trial: Stored, why: str) -> Stored:
    return replace(trial, status="error", reason=why, records=[])


def _lost(plan: Mapping[str, Any], there: Collection[str], why: str) -> dict[str, Stored]:
    """Planned trials that are not there, where some were lost: nobody knows which."""
    return {
        row["trial"]: Stored(
            row["trial"], row["identity"], {name: row[name] for name in LABELS}, "error", why
        )
        for row in plan["trials"]
        if row["trial"] not in there
    }


def _why(rows: list[dict[str, Any]], measure: str, metric: str) -> str:
    """Status and reason of the rows that failed; without one, the number was never recorded."""
    failed = [row for row in rows if row["status"] not in SHOWN]
    exact = [row for row in failed if row["metric"] == metric]
    for row in [*exact, *failed][:1]:
        reason = " ".join(str(row["reason"]).split())
        return f"{row['status']}: {reason}" if reason else str(row["status"])
    if any(row["metric"] == metric for row in rows):
        return f"nonfinite: {metric} of {measure} is not a number"
    return f"not recorded: {metric} of {measure}"


def _registry_name(row: dict[str, Any]) -> str:
    method = row["identity"].get("method")
    return str(method["name"]) if isinstance(method, dict) else str(row["method"])


def _estimate(row: dict[str, Any]) -> Estimate:
    low, high = row["ci_low"], row["ci_high"]
    known = not (math.isnan(low) or math.isnan(high))
    return Estimate(row["value"], *((low, high) if known else ()))
