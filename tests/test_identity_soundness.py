"""Nothing is missed: all code of ours that runs in a trial is among what its digests cover."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
import yaml
from rich.console import Console

from harness.identity import ours
from harness.identity.executed import recorded
from harness.measures import registry as measures
from harness.mitsuba_runtime import variant
from harness.runner.run import Options, run
from harness.suite import source_parts
from harness.suite.load import load
from harness.suite.plan import Plan, make_plan

WITHOUT_NUMBERS = (
    # They plan, store, show, find things by name and say what is wrong.
    "harness.cli",
    "harness.core.classes",
    "harness.core.jsonfile",
    "harness.core.machine",
    "harness.core.protocol.errors",
    "harness.core.registry",
    "harness.effects.offer:require_of",
    "harness.identity",
    "harness.materials.registry",
    "harness.measures.registry",
    "harness.mitsuba_runtime.exr",
    "harness.report",
    "harness.runner",
    "harness.scenes.named_files",
    "harness.scenes.registry",
    "harness.store",
    "harness.suite",
    # Checks of specifications, and where files are.
    "harness.materials.families.registry:Described.check",
    "harness.materials.families.registry:Described.file",
    "harness.materials.families.parameters:check",
    "harness.materials.kinds:",
    "harness.materials.neural.files:",
    # Records are made of stored arrays, and made anew when this changes.
    "harness.analysis",
    "harness.core.record",
    "harness.stats",
)
"""Modules, or units in them, that no part of a trial has to cover."""

TINY_RENDER = {"batches": 6, "spp": 2, "resolution": 8, "reference_spp": 8}


def executed_and_covered(
    folder: Path,
    materials: list[Any],
    methods: list[Any],
    chosen: list[dict[str, Any]],
    scenes: list[Any] | None = None,
) -> tuple[set[str], set[str]]:
    """What runs in a suite, and what the parts of its trials reach."""
    suite = {
        "name": "tiny",
        "materials": materials,
        "methods": methods,
        "measures": chosen,
        "budget": {"steps": 2, "conditions": 8, "directions": 8, "resolution": 8, "pool": 16},
        **({"scenes": scenes} if scenes else {}),
    }
    file = folder / "tiny.yaml"
    file.write_text(yaml.safe_dump(suite))
    variant.use("cpu")
    known = ours.digests(cached=False)
    plan = make_plan(load(str(file)))
    said = io.StringIO()
    with recorded(known.tree) as ran:
        here = Options(executor="inline", refit=True)
        status = run(plan, folder / "results", here, Console(file=said))
    assert status == 0, said.getvalue()
    return ran, _reached(plan)


def _reached(plan: Plan) -> set[str]:
    known = ours.digests(cached=False)
    found: set[str] = set()
    for trial in plan.trials:
        placed = None
        if trial.scene:
            made = plan.resolved.scene(trial)
            around = [s.material for s in getattr(made, "shapes", ()) if s.material]
            placed = source_parts.scene(trial.scene_spec, made, around)
        parts = source_parts.parts_of(
            known, trial.method_name, trial.material_spec, measures.load(trial.measure), placed
        )
        for _, reached in known.reached(parts).values():
            found |= {str(unit) for unit in reached.units.values()}
    return found


def uncovered(ran: set[str], reached: set[str]) -> list[str]:
    return sorted(unit for unit in ran - reached if not unit.startswith(WITHOUT_NUMBERS))


def test_nothing_that_runs_in_a_trial_is_missed(tmp_path):
    ran, reached = executed_and_covered(
        tmp_path,
        ["rim-lobe"],
        ["improved-baseline"],
        [
            {"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8},
            {"name": "sample-weights", "conditions": 4, "samples": 16},
            {"name": "equal-spp", **TINY_RENDER},
        ],
        ["uniform-sphere"],
    )
    assert len(ran & reached) > 150  # the hook saw the trials
    assert uncovered(ran, reached) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("materials", "methods", "chosen", "scenes"),
    [
        (["suede"], ["histogram"], [{"name": "pdf", "conditions": 4, "resolution": 8}], None),
        (
            [{"name": "rough", "type": "family", "family": "ggx-conductor", "walks": 4}],
            ["random-walk"],
            [{"name": "sample-weights", "conditions": 4, "samples": 16}],
            None,
        ),
        (["rim-lobe"], ["realnvp"], [{"name": "stability", "cases": ["rim-lobe"]}], None),
        (["leather"], ["blinn-phong"], [{"name": "equal-spp", **TINY_RENDER, "resolution": 24}],
         ["shelf"]),
        (["disney"], ["importance-baked"], [{"name": "image-checks", "resolution": 8}],
         ["draped-cloth"]),
        (["suede"], ["cosine"], [{"name": "throughput", "rounds": 3, "batch": 256}], None),
        (["leather"], ["two-lobe"], [{"name": "levels", "levels": 1, "views": 1, "size": 8}], None),
    ],
)  # fmt: skip
def test_nothing_is_missed_in_other_trials(materials, methods, chosen, scenes, tmp_path):
    ran, reached = executed_and_covered(tmp_path, materials, methods, chosen, scenes)
    assert uncovered(ran, reached) == []


def test_the_hook_sees_what_runs():
    from harness.geometry import shapes

    with recorded(ours.digests(cached=False).tree) as ran:
        shapes.grid_faces(2, 2)
    assert {u for u in ran if not u.startswith("harness.identity")} == {
        "harness.geometry.shapes:grid_faces"
    }


def test_code_that_is_not_covered_would_be_told():
    assert uncovered({"harness.nets.lobes:log_prob", "harness.cli.run:run"}, set()) == [
        "harness.nets.lobes:log_prob"
    ]
