"""The profile ``fast`` that every suite has: rough numbers of a part of it, in a minute or two."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from harness.core.protocol.method import Budget
from harness.measures import registry as measures
from harness.suite.schema import BudgetSpec, MethodSpec, Override, Profile, Suite

NAME = "fast"
BUDGET = {"steps": 100, "conditions": 64, "directions": 32, "resolution": 32, "pool": 256}
"""The most that a fit may spend."""
SECONDS, UNTIL = 2.0, 0.9
"""The same of a fit that is told a time, and of one that goes on until KL moves by less."""
MOST: dict[str, Any] = {
    "longest": 1,
    "points": 32,
    "pixels": 256,
    "batches": 6,
    "spp": 8,
    "reference_spp": 512,
    "truth_spp": 64,
    "walks": 65_536,
    "resolution": 48,
    "max_seconds": 4.0,
    "conditions": 32,
    "samples": 128,
    "count": 2,
    "grid": 64,
    "bins": 16,
    "side": 64,
    "rounds": 6,
    "slice_seconds": 0.03,
    "deadline": 0.2,
    "warm_up": 0.5,
    "patience": 60.0,
    "levels": 5,
    "repeats": 2,
    "processes": 1,
    "starts": 1,
    "least_seconds": 0.01,
    "batch": 65_536,
    "rows": 131_072,
    "views": 2,
    "picture_size": 128,
    "size": 32,
    "slice_resolution": 64,
}
"""By setting: the most that a measure may have; a smaller one stays."""
NO_MORE = {"max_rounds": 6, "max_processes": 1}
"""Settings that would go on while an interval is wide."""


def profile_of(suite: Suite, base: Profile, fitted: Collection[str] = ()) -> Profile:
    """``base`` made small: its first material, scene and seed, and none but sweeps' own methods.

    ``fitted`` are labels of methods whose fits to that material, as ``base`` has them, are there.
    """
    methods = _methods(suite, base)
    scenes = (base.scenes or [scene.name for scene in suite.scenes])[:1]
    return Profile(
        materials=(base.materials or [material.name for material in suite.materials])[:1],
        methods=[method.label for method in methods],
        scenes=scenes or None,
        seeds=(base.seeds or suite.seeds)[:1],
        training_seeds=(base.training_seeds or suite.training_seeds or [])[:1] or None,
        measures={m.name: _settings(suite, base, m.name, m.rest()) for m in suite.measures},
        budget=base.budget,
        override={
            method.label: base.override.get(method.label, Override())
            if method.label in fitted
            else _override(suite, base, method)
            for method in methods
        },
    )


def note(profile: Profile) -> str:
    """What is said of its numbers."""
    places = [*(profile.materials or []), *(profile.scenes or [])]
    return f"rough numbers: short fits, few samples; of {' in '.join(places)} alone"


def _methods(suite: Suite, base: Profile) -> list[MethodSpec]:
    """Those of the profile, without variants that a sweep made; all of them if nothing is left."""
    chosen = [m for m in suite.methods if base.methods is None or m.label in base.methods]
    return [m for m in chosen if not m.swept_from or m.label == suite.baseline] or chosen


def _override(suite: Suite, base: Profile, method: MethodSpec) -> Override:
    own = base.override.get(method.label, Override())
    given = suite.budget.given() | base.budget.given() | method.budget.given() | own.budget.given()
    least = {key: min(given.get(key, getattr(Budget(), key)), most) for key, most in BUDGET.items()}
    if "seconds" in given:  # in place of steps
        least["seconds"] = min(given["seconds"], SECONDS)
    if "until" in given:
        least["until"] = max(given["until"], UNTIL)
    return Override(params=own.params, budget=BudgetSpec(**(own.budget.given() | least)))


def _settings(suite: Suite, base: Profile, name: str, own: dict[str, Any]) -> dict[str, Any]:
    """A measure's settings as in ``base``, none above the most."""
    measure = measures.load(name)
    known = {
        key: field.get_default(call_default_factory=True)
        for key, field in measure.Settings.model_fields.items()
    }
    given = base.measures.get(name, {})
    # As a plan has them: the suite's resolution, the measure's entry, the profile's.
    sizes = [
        {"resolution": owner.resolution} if measure.needs_scene and owner.resolution else {}
        for owner in (suite, base)
    ]
    full = known | sizes[0] | own | sizes[1] | given
    small = {
        key: min(full[key], most)
        for key, most in MOST.items()
        if key in known and full[key] is not None
    }
    for key, most in NO_MORE.items():
        if key in known:
            small[key] = most if full[key] is None else min(full[key], most)
    return given | small
