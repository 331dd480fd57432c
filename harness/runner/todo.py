"""What is left to do: the plan, less what is stored."""

from __future__ import annotations

from dataclasses import dataclass, field

from harness.identity.verdict import Verdict
from harness.measures.base import FAILED
from harness.runner.only import Only
from harness.runner.validity import Validity
from harness.store.stored import Stored
from harness.suite.plan import Plan
from harness.suite.trials import FIT, Trial

FINAL = ("ok", "unsupported")


@dataclass
class Group:
    """Trials that one call of a measure carries out.

    ``extra`` is the baseline where it has to run along but is not itself to be done.
    """

    trials: list[Trial]
    extra: Trial | None = None


@dataclass
class Unit:
    """All that is to be done for one material: fits first, then groups of measures."""

    material: str
    fits: list[Trial] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)

    @property
    def trials(self) -> list[Trial]:
        """Every trial of the unit that is to be stored."""
        return self.fits + [trial for group in self.groups for trial in group.trials]


@dataclass
class Todo:
    """``units`` to carry out; ``selected`` trials the run is about, done or not.

    ``stored`` are the planned trials that are there, ``stale`` why some of them do not hold any
    more, ``equivalent`` that their code changed and their numbers did not. ``doubtful`` ones are
    to be measured only if their fit, which is made again, comes out different. ``unprobed`` is why
    some code could not be probed, by part and material.
    """

    units: list[Unit]
    selected: list[Trial]
    stored: dict[str, Stored]
    stale: dict[str, Verdict] = field(default_factory=dict)
    doubtful: frozenset[str] = frozenset()
    equivalent: dict[str, Verdict] = field(default_factory=dict)
    unprobed: dict[tuple[str, str], str] = field(default_factory=dict)
    seen: dict[str, Stored] = field(default_factory=dict)
    """All planned trials that are stored, whether their numbers hold or not."""

    @property
    def trials(self) -> list[Trial]:
        """All trials to be carried out, in order."""
        return [trial for unit in self.units for trial in unit.trials]


def make_todo(
    plan: Plan,
    stored: dict[str, Stored],
    validity: Validity,
    only: Only,
    retry_failed: bool = False,
    refit: bool = False,
) -> Todo:
    """Compare ``plan`` with what is ``stored``, by key.

    A trial is done if it is stored as ok or unsupported and its numbers still hold, or as failed
    unless those are to be tried again. One that was skipped is done as soon as it can be. With
    ``refit``, fits that came with the harness, and what was measured with them, are to be done.
    """
    by_hash = _one_label_each(plan)
    # A fit that came with the harness is data: other code would not make it another one.
    judged = [h for h, found in stored.items() if h in by_hash and not found.shipped]
    verdicts = {h: validity.verdict(by_hash[h]) for h in judged}
    stale = {h: v for h, v in verdicts.items() if not v.stands}
    present = {h: found for h, found in stored.items() if h not in stale}
    if refit:
        came = {h for h, found in present.items() if found.shipped}
        came |= {t.hash for t in plan.trials if came & set(needed_fits(plan, t))}
        present = {h: found for h, found in present.items() if h not in came}
    selected = [trial for trial in plan.trials if trial in only]
    open_: dict[str, Trial] = {}
    for trial in selected:
        found = present.get(trial.hash)
        if _done(found, retry_failed):
            continue
        needs = [present.get(fit) for fit in needed_fits(plan, trial)]
        hopeless = any(n is not None and n.status != "ok" and _done(n, retry_failed) for n in needs)
        if found is None or not hopeless:
            open_[trial.hash] = by_hash[trial.hash]
    # What is to be measured has to be fitted, also if --only did not name the fit.
    for trial in [t for t in open_.values() if t.measure != FIT]:
        for fit in needed_fits(plan, trial):
            state = present.get(fit)
            usable = state is not None and (state.status != "ok" or state.has_state)
            if not (usable and _done(state, retry_failed)):
                open_[fit] = by_hash[fit]
    fits = [t for t in by_hash.values() if t.measure == FIT and t.hash in open_]
    again = {fit.hash for fit in fits}
    doubtful = [t for t in selected if t.hash not in open_ and again & set(needed_fits(plan, t))]
    open_ |= {trial.hash: by_hash[trial.hash] for trial in doubtful}
    groups = _groups(plan, [t for t in open_.values() if t.measure != FIT])
    units: dict[str, Unit] = {}
    for material in plan.labels("material"):
        unit = Unit(material)
        unit.fits = [t for t in fits if t.material == material]
        unit.groups = [g for g in groups if g.trials[0].material == material]
        if unit.fits or unit.groups:
            units[material] = unit
    names = frozenset(trial.hash for trial in doubtful)
    equivalent = {h: v for h, v in verdicts.items() if v.state == "equivalent"}
    return Todo(list(units.values()), selected, present, stale, names, equivalent, seen=stored)


def needed_fits(plan: Plan, trial: Trial) -> list[str]:
    """Hashes of the fits that ``trial`` cannot do without: its own, and the baseline's."""
    if trial.measure == FIT:
        return []
    return [trial.fit, plan.baseline_of(trial).fit] if trial.timed else [trial.fit]


def _done(stored: Stored | None, retry_failed: bool) -> bool:
    if stored is None or stored.status == "skipped":
        return False
    return stored.status in FINAL or not (retry_failed and stored.status in FAILED)


def _groups(plan: Plan, pending: list[Trial]) -> list[Group]:
    """Untimed trials one by one, ordered so that what they share is made once; then timed."""
    scenes = ["", *plan.labels("scene")]
    measures = plan.labels("measure")

    def shared(trial: Trial) -> tuple[int, ...]:
        return (trial.seed, scenes.index(trial.scene), measures.index(trial.measure))

    groups = [Group([t]) for t in sorted((t for t in pending if not t.timed), key=shared)]
    timed: dict[tuple, list[Trial]] = {}
    for trial in pending:
        if trial.timed:
            timed.setdefault((trial.material, *shared(trial)), []).append(trial)
    for trials in timed.values():
        first = trials[0]
        base = plan.baseline_of(first)
        inside = any(trial.hash == base.hash for trial in trials)
        groups.append(Group(trials, None if inside else base))
    return groups


def _one_label_each(plan: Plan) -> dict[str, Trial]:
    """By hash, in order: two labels of one and the same method share their trials.

    They go by the baseline's label where that is one of the two, else by the first.
    """
    found: dict[str, Trial] = {}
    for trial in plan.trials:
        if trial.hash not in found or trial.method == plan.baseline:
            found[trial.hash] = trial
    return found
