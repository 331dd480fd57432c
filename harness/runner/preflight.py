"""What is refused before anything runs: devices, adapters, materials and report names."""

from __future__ import annotations

from typing import Any

from harness.core import registry
from harness.core.protocol.errors import InputError, nearest
from harness.report.parts import KINDS, names
from harness.runner.executor import Executor, carry_out
from harness.runner.task import CHECK, Task
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


def check_trials(plan: Plan, trials: list[Trial], execute: Executor) -> None:
    """Adapters of ``trials`` import and take their parameters; files they need are readable.

    Adapters are constructed where they will run. One that hangs there, or ends its process, is no
    matter of the suite's: its trials will say so. Materials by name come with the harness and are
    made when their turn comes; those that a suite describes are made here.
    """
    seen: set[tuple[str, str]] = set()
    check_effects(plan, trials)
    for trial in trials:
        for kind, label, refused in (
            ("methods", trial.method, lambda t=trial: _refused(plan, t, execute)),
            ("materials", trial.material, lambda t=trial: _described(plan, t)),
        ):
            if (kind, label) in seen:
                continue
            seen.add((kind, label))
            if text := refused():
                raise InputError(f"{plan.where}: {kind}: '{label}': {text}")


def _refused(plan: Plan, trial: Trial, execute: Executor) -> str:
    """Why the method of a trial cannot be constructed; "" if it can."""
    return carry_out(execute, Task(CHECK, (trial,), plan.baseline)).refused


def _described(plan: Plan, trial: Trial) -> str:
    """Why a material that the suite describes cannot be made; "" if it can."""
    if not isinstance(trial.material_spec, dict):
        return ""
    try:
        plan.resolved.material(trial)
    except Exception as error:
        text = str(error) if isinstance(error, InputError) else registry.oneline(error)
        return text.strip().partition("\n")[0]
    return ""


def check_effects(plan: Plan, trials: list[Trial]) -> None:
    """Every material can give what the scenes of its trials call for.

    Only a scene that names effects of the material has its material made here.
    """
    from harness.effects.offer import require_of
    from harness.effects.registry import is_auto, parse

    for trial in {(t.scene, t.material): t for t in trials if t.scene}.values():
        scene: Any = plan.resolved.scene(trial)
        if is_auto(scene.effects) or not any(effect.own for effect in parse(scene.effects)):
            continue
        try:
            require_of(scene, plan.resolved.material(trial))
        except InputError as error:
            raise InputError(f"{plan.where}: scenes: {error}") from None
