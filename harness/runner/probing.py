"""Probes of a trial's parts: small computations that tell whether changed code gives other numbers.

A part's probe does what the part does in the trial, on little: the fitted method gives samples, the
material is evaluated, the method is trained for two steps, the measure runs on a tiny job with two
methods that need no fit, one over columns and one in torch. Of a timed measure what it times is
done and not the timing, whose own code no probe speaks for.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import torch
from pydantic import ValidationError

from harness.core import registry
from harness.core.protocol.method import Budget, Method
from harness.effects.registry import is_auto
from harness.identity import small
from harness.identity.digests import Digests, Part
from harness.identity.probe import Computed, Probe, computed
from harness.identity.small import Arrays
from harness.identity.tree import Unit
from harness.identity.verdict import ADAPTER, BASELINE, MATERIAL, MEASURE, SCENE, TRAINING
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.measures.base import Job
from harness.measures.fit import restore
from harness.runner.jobs import Jobs
from harness.scenes import registry as scenes
from harness.suite.trials import FIT, Trial, stream_seed

TINY = {
    "angles": 2, "batches": 6, "conditions": 4, "count": 2, "grid": 8, "levels": 2, "longest": 2,
    "pairs": 16, "reference_spp": 8, "repeats": 2, "resolution": 24, "resolutions": [8],
    "rounds": 6, "samples": 16, "side": 16, "size": 8, "slice_resolution": 16, "spp": 2,
    "truth_spp": 24, "views": 1, "walks": 4096,
}  # fmt: skip
"""Settings of a measure's tiny job, where it has them and they are larger.

An image has to be large enough to show the material in every scene.
"""
FIXED = ({"name": "cosine"}, {"name": "tabulated", "params": {"resolution": 8}})
"""Methods of a measure's tiny job: one over columns, one in torch."""
STEPS = 2
_SEED = 11


class Prober:
    """Makes probes of trials, with the materials, scenes and fitted methods of ``jobs``."""

    def __init__(self, jobs: Jobs, known: Digests):
        self.jobs, self.known = jobs, known
        self._computed: dict[tuple[Any, ...], Computed] = {}

    def probe(self, trial: Trial, part: str, parts: dict[str, Part], timed: bool = True) -> Probe:
        """Of the ``part`` of ``trial``, whose code begins at ``parts``; takes a second or so.

        ``timed``: whether its work is recorded, which takes a second run.

        Raises:
            Exception: whatever the code raises. Without a probe nothing is known.
        """
        key = timed, *self._computation(trial, part)
        if key not in self._computed:
            repeated = self._repeated(trial, part) if timed else None
            self._computed[key] = computed(
                self.known.tree, lambda: self.arrays(trial, part), repeated, timed
            )
        return self._computed[key].of(self._units(part, parts))

    def _repeated(self, trial: Trial, part: str) -> Callable[[], Any] | None:
        """Without what is done once for all samples: a material is made before the clock starts."""
        if part != MATERIAL:
            return None
        made = self.jobs.resolved.material(trial)
        return lambda: small.of_material(made, trial.budget.device)

    @staticmethod
    def _computation(trial: Trial, part: str) -> tuple[Any, ...]:
        """What :meth:`arrays` depends on: parts that share it are computed once."""
        material = repr(trial.material_spec)
        method = (trial.method_name, repr(trial.params), repr(trial.budget), trial.fit)
        if part == MATERIAL:
            return part, material
        if part in (MEASURE, SCENE) and trial.measure != FIT:
            settings = repr(tiny(trial.measure, trial.settings))
            return MEASURE, trial.measure, settings, trial.seed, material, repr(trial.scene_spec)
        return trial.measure == FIT and part == MEASURE, *method, material

    def arrays(self, trial: Trial, part: str) -> Arrays:
        """The numbers of a probe."""
        device = trial.budget.device
        torch.manual_seed(_SEED)
        if part == MATERIAL:
            # Made anew, for how it is made is part of it.
            return small.of_material(materials.make(trial.material_spec), device)
        material = self.jobs.resolved.material(trial)
        if part in (ADAPTER, TRAINING, BASELINE) and trial.measure == FIT:
            return self._trained(trial, material, device)
        if part in (ADAPTER, BASELINE):
            method = registry.make(trial.method_name, **trial.params)
            state = self.jobs.make(trial).method.state_dict()
            return small.of_method(restore(method, material, state), material, device)
        if part == MEASURE and trial.measure == FIT:
            return self._fitted(trial, material)
        if part in (MEASURE, SCENE):
            return self._measured(trial, material)
        raise ValueError(f"{part} has no probe")

    def _units(self, part: str, parts: dict[str, Part]) -> dict[tuple[str, str], Unit]:
        """What the part's code reaches; of the scene and the measure, what both do."""
        found = self.known.reached(parts)
        wanted = {MEASURE: (MEASURE, SCENE), SCENE: (MEASURE, SCENE)}.get(part, (part,))
        wanted = tuple({TRAINING: ADAPTER, BASELINE: ADAPTER}.get(name, name) for name in wanted)
        return {
            key: unit
            for name in wanted
            if name in found
            for key, unit in found[name][1].units.items()
        }

    def _trained(self, trial: Trial, material: Any, device: str) -> Arrays:
        """State and samples of a method after two steps on a tiny budget."""
        method = registry.make(trial.method_name, **trial.params)
        report = method.fit(material, self._budget(trial), torch.Generator().manual_seed(_SEED))
        found = small.of_method(method, material, device)
        found |= {f"state {k}": v.detach().cpu().numpy() for k, v in method.state_dict().items()}
        return found | {"loss": torch.tensor(report.loss).numpy()}

    @staticmethod
    def _budget(trial: Trial) -> Budget:
        small = {"steps": STEPS, "conditions": 8, "directions": 8, "resolution": 8, "pool": 16}
        return replace(trial.budget, **small, seconds=None, until=None)

    def _fitted(self, trial: Trial, material: Any) -> Arrays:
        """What the measure ``fit`` stores of a method that is trained for two steps."""
        method = registry.make(trial.method_name, **trial.params)
        job = self._job(
            trial, material, method, {"name": trial.method_name, "params": trial.params}
        )
        job.budget = self._budget(trial)
        (outcome,) = measures.make(FIT).run([job], _quiet)
        found = small.of_outcome(outcome)
        return {name: value for name, value in found.items() if "seconds" not in name}

    def _measured(self, trial: Trial, material: Any) -> Arrays:
        """Raw outputs of the measure for both fixed methods, or what a timed one times."""
        kind = measures.load(trial.measure)
        scene = self._scene(trial)
        found = {}
        for spec in FIXED:
            method = restore(registry.make(spec), material, {})
            if kind.timed:
                one = self._timed(trial, material, method, scene)
            else:
                (outcome,) = kind().run([self._job(trial, material, method, spec, scene)], _quiet)
                one = small.of_outcome(outcome)
            found |= {f"{method.name} {name}": value for name, value in one.items()}
        return found

    def _scene(self, trial: Trial) -> Any:
        """Made anew, unless what ``auto`` stands for has to be found first."""
        if not trial.scene:
            return None
        made = scenes.make(trial.scene_spec)
        return self.jobs.scene(trial) if is_auto(made.effects) else made

    def _timed(self, trial: Trial, material: Any, method: Method, scene: Any) -> Arrays:
        if scene is None:
            return small.of_method(method, material, trial.budget.device)
        from harness.rendering.prepared import prepare

        done = prepare(scene, material, method, TINY["resolution"])
        image = done.render(TINY["spp"], _SEED)
        return {"rgb": image.rgb, "variance": image.variance, "mask": done.mask}

    @staticmethod
    def _job(trial: Trial, material: Any, method: Method, spec: Any, scene: Any = None) -> Job:
        seed = stream_seed(trial.measure, trial.seed)
        return Job(
            trial=trial,
            material=material,
            method=method,
            scene=scene,
            seed=trial.seed,
            generator=torch.Generator().manual_seed(seed),
            settings=tiny(trial.measure, trial.settings),
            budget=trial.budget,
            make=lambda: registry.make(spec),
            fit_records={},
        )


def tiny(measure: str, settings: dict[str, Any]) -> dict[str, Any]:
    """A measure's settings with sizes made as small as it allows."""
    model = measures.load(measure).Settings
    found = dict(settings)
    for name, value in TINY.items():
        if name in found and found[name] is not None:
            smaller = value if isinstance(value, list) else min(value, found[name])
            try:
                model.model_validate_json(json.dumps(found | {name: smaller}))
            except ValidationError:
                continue
            found[name] = smaller
    return found


def _quiet(text: str) -> None:
    """Nobody watches."""


def names(parts: Iterable[str]) -> list[str]:
    """Those of ``parts`` that a probe can be made of."""
    return [p for p in parts if p in (ADAPTER, TRAINING, BASELINE, MATERIAL, MEASURE, SCENE)]
