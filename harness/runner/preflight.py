"""What is refused before anything runs: devices, adapters, materials and report names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from harness.core import registry
from harness.core.protocol.errors import InputError, nearest
from harness.report.parts import KINDS, names
from harness.suite.plan import Plan
from harness.suite.trials import Trial


def ready(device: str) -> None:
    """Make Mitsuba and torch ready for ``device``, or say what is missing."""
    from harness.mitsuba_runtime import variant

    variant.use(device)
    if device == "cuda":
        import torch

        if not torch.cuda.is_available():
            raise InputError(
                "device 'cuda' needs a CUDA build of PyTorch, and this one sees no GPU;"
                " use device 'cpu'"
            )


def check_report(plan: Plan) -> None:
    """The tables and figures that the suite wants exist."""
    for kind in KINDS:
        known = names(kind)
        for index, name in enumerate(plan.report[kind] or ()):
            if name not in known:
                raise InputError(
                    f"{plan.where}: report.{kind}[{index}]: unknown {kind[:-1]} '{name}'"
                    f"{nearest(name, known)}"
                )


def check_trials(plan: Plan, trials: list[Trial]) -> None:
    """Adapters of ``trials`` import and take their parameters; files they need are readable.

    Materials and scenes by name come with the harness and are made when their turn comes;
    those that a suite describes are made here.
    """
    from harness.materials import registry as materials
    from harness.scenes import registry as scenes

    seen: list[tuple] = []
    check_effects(plan, trials)
    for trial in trials:
        for kind, label, spec in (
            ("methods", trial.method, (trial.method_name, trial.params)),
            ("materials", trial.material, trial.material_spec),
            ("scenes", trial.scene, trial.scene_spec),
        ):
            if (kind, label) in seen:
                continue
            seen.append((kind, label))
            try:
                if kind == "methods":
                    registry.make(trial.method_name, **trial.params)
                elif isinstance(spec, dict):
                    (materials if kind == "materials" else scenes).make(spec)
            except Exception as error:
                text = str(error) if isinstance(error, InputError) else registry.oneline(error)
                text = text.strip().partition("\n")[0]
                raise InputError(f"{plan.where}: {kind}: '{label}': {text}") from error


def check_effects(plan: Plan, trials: list[Trial]) -> None:
    """Every material can give what the scenes of its trials call for.

    Only a scene that names effects of the material has its material made here.
    """
    from harness.effects.offer import require_of
    from harness.effects.registry import is_auto, parse
    from harness.materials import registry as materials
    from harness.scenes import registry as scenes

    made: dict[str, Any] = {}
    pairs = {(t.scene, t.material): t for t in trials if t.scene}
    for trial in pairs.values():
        scene = made.setdefault(f"scene {trial.scene}", None) or scenes.make(trial.scene_spec)
        made[f"scene {trial.scene}"] = scene
        if is_auto(scene.effects):
            continue
        if not any(effect.own for effect in parse(scene.effects)):
            continue
        if trial.material not in made:
            made[trial.material] = materials.make(trial.material_spec)
        try:
            require_of(scene, made[trial.material])
        except InputError as error:
            raise InputError(f"{plan.where}: scenes: {error}") from None


def check_output(results: Path) -> None:
    """The results folder is one, or can become one."""
    if results.exists() and not results.is_dir():
        raise InputError(f"{results}: is a file; expected a folder for the results")
    try:
        results.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{results}: cannot be made: {error.strerror}") from None
