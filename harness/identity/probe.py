"""Probes: kept with a trial, made again when code has changed, and compared.

A probe is a small computation (:mod:`harness.identity.small`) with what it says of the code: which
regions of it ran, and how much work it was. If its numbers are the same, and the changed places are
among those that ran, then the code changed and the numbers of the trial did not.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.identity.coverage import Coverage, covered
from harness.identity.small import ROUNDING, TOLERANCE, Arrays, agree, identical
from harness.identity.tree import Tree, Unit
from harness.identity.tried import tried
from harness.identity.work import recorded

_NOTES = "notes"


@dataclass(frozen=True)
class Probe:
    """What a probe gave.

    ``arrays`` are its numbers, ``work`` a digest of what the machine was made to do, "" where that
    was not asked. ``regions``
    are, by function (``module:unit``), the marks of regions that ran and of those that did not;
    ``tried`` the values and classes that the numbers speak for. ``figures`` are, by unit, sums of
    hashes of the numbers and comparisons in the source text.
    """

    arrays: Mapping[str, NDArray[Any]]
    work: str
    regions: Mapping[str, tuple[frozenset[str], frozenset[str]]]
    tried: frozenset[str]
    figures: Mapping[str, int] = field(default_factory=dict)

    def packed(self) -> Arrays:
        """All of it as arrays, to be stored."""
        regions = {u: [" ".join(sorted(m)) for m in both] for u, both in self.regions.items()}
        notes = {
            "work": self.work,
            "regions": regions,
            "tried": sorted(self.tried),
            "figures": dict(self.figures),
        }
        text = json.dumps(notes, sort_keys=True)
        return {**self.arrays, _NOTES: np.frombuffer(text.encode(), np.uint8)}

    @classmethod
    def unpacked(cls, arrays: Mapping[str, NDArray[Any]]) -> Probe:
        """Inverse of :meth:`packed`."""
        notes = json.loads(bytes(arrays[_NOTES]))
        regions = {
            unit: (frozenset(run.split()), frozenset(missed.split()))
            for unit, (run, missed) in notes["regions"].items()
        }
        rest = {name: value for name, value in arrays.items() if name != _NOTES}
        tried_units = frozenset(notes["tried"])
        return cls(rest, notes["work"], regions, tried_units, notes.get("figures", {}))


@dataclass(frozen=True)
class Computed:
    """A small computation: its numbers, a digest of its work or "", and what of the code ran."""

    arrays: Arrays
    work: str
    coverage: Coverage

    def of(self, units: Mapping[tuple[str, str], Unit]) -> Probe:
        """What it says of code that reaches ``units``."""
        inside = {str(unit) for unit in units.values()}
        regions = {u: (ran.run, ran.missed) for u, ran in self.coverage.items() if u in inside}
        figures = {str(unit): unit.figures for unit in units.values() if unit.figures}
        return Probe(self.arrays, self.work, regions, tried(units, self.coverage), figures)


def computed(
    tree: Tree,
    compute: Callable[[], Arrays],
    repeated: Callable[[], Any] | None = None,
    timed: bool = True,
) -> Computed:
    """The numbers of ``compute``, what of ``tree`` ran for them, and if it is ``timed`` its work.

    The work is that of a second run, for the first compiles and loads. ``repeated`` is that of it
    whose time a trial may take, by default all.
    """
    with covered(tree) as coverage:
        arrays = compute()
    if not timed:
        return Computed(arrays, "", coverage)
    if repeated is not None:
        repeated()  # on what is kept, which may not have been used yet
    with recorded() as work:
        (repeated or compute)()
    return Computed(arrays, work.digest, coverage)


def difference(
    old: Probe,
    new: Probe,
    old_units: Mapping[str, str],
    new_units: Mapping[str, str],
    timed: bool = False,
    trained: bool = False,
) -> str:
    """Why the numbers of a trial may have changed with its code; "" if they have not.

    ``old_units`` and ``new_units`` are the units of the part with their hashes, as in
    :class:`~harness.identity.digests.SourceDigest`. What is different between them has to have run.
    A ``timed`` trial needs the same work too. What is ``trained`` needs numbers that are equal but
    for rounding, for many steps would amplify more. Where the source text has other numbers or
    comparisons than before and not a bit of the probe's numbers changed, they may be limits that it
    does not come near: that is no agreement.
    """
    untried = sorted(
        {
            *_untried(new, old, new_units, old_units, _moved(new_units, old_units)),
            *_untried(old, new, old_units, new_units, _moved(old_units, new_units)),
        }
    )
    if untried:
        more = f" and {len(untried) - 1} more" if len(untried) > 1 else ""
        return f"{untried[0]}{more} changed, which the probe does not run there"
    if not agree(old.arrays, new.arrays, ROUNDING if trained else TOLERANCE):
        return "the numbers of the probe changed"
    other_figures = _figures(old, old_units, new_units) != _figures(new, new_units, old_units)
    if other_figures and identical(old.arrays, new.arrays):
        return "a number in the code changed, which the probe does not feel"
    if timed and not (old.work and new.work):
        return "it is not known what work was timed"
    if timed and old.work != new.work:
        return "the work that is timed changed"
    return ""


def _figures(probe: Probe, here: Mapping[str, str], there: Mapping[str, str]) -> int:
    """Sum over the units that are only ``here``."""
    known_as = _moved(here, there)
    return (
        sum(
            probe.figures.get(unit, 0)
            for unit, value in here.items()
            if there.get(known_as.get(unit, "")) != value
        )
        % 2**32
    )


def _untried(
    probe: Probe,
    other: Probe,
    here: Mapping[str, str],
    there: Mapping[str, str],
    known_as: Mapping[str, str],
) -> list[str]:
    """Units that differ ``here`` from ``there`` in a place that ``probe`` did not run."""
    found = []
    for unit, value in here.items():
        twin = known_as.get(unit, "")
        if twin and there[twin] == value:
            continue
        if unit in probe.regions:
            run, missed = probe.regions[unit]
            before = frozenset().union(*other.regions.get(twin, ()))
            only_here = missed - before
            # Nothing of its own text changed: what it calls did, wherever in it that is.
            same_text = run | missed == before
            if only_here or (same_text and missed):
                found.append(unit)
        elif unit not in probe.tried:
            found.append(unit)
    return found


def _moved(here: Mapping[str, str], there: Mapping[str, str]) -> dict[str, str]:
    """For each unit the one it was, or became: of the same name, if there is no other of it."""
    by_name: dict[str, list[str]] = {}
    for unit in there:
        by_name.setdefault(unit.rpartition(":")[2], []).append(unit)
    found = {}
    for unit in here:
        others = by_name.get(unit.rpartition(":")[2], [])
        if unit in there:
            found[unit] = unit
        elif len(others) == 1:
            found[unit] = others[0]
    return found
