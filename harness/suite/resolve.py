"""Materials and scenes of a suite's trials, each made once, whoever asks first."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harness.core.protocol.material import Material
    from harness.suite.trials import Trial


class Resolved:
    """What the specifications of trials stand for; nothing is made before it is asked for.

    Specifications are told apart by their content: two labels of one material share it.
    """

    def __init__(self) -> None:
        self._materials: dict[str, Material] = {}
        self._scenes: dict[str, Any] = {}

    def material(self, trial: Trial) -> Material:
        """The trial's material."""
        key = repr(trial.material_spec)
        if key not in self._materials:
            from harness.materials import registry as materials

            self._materials[key] = materials.make_tested(trial.material_spec)
        return self._materials[key]

    def scene(self, trial: Trial) -> Any | None:
        """The trial's scene as the suite has it; None for a measure without one."""
        return self.scene_of(trial.scene_spec) if trial.scene else None

    def scene_of(self, spec: Any) -> Any:
        """The scene of a specification."""
        key = repr(spec)
        if key not in self._scenes:
            from harness.scenes import registry as scenes

            self._scenes[key] = scenes.make(spec)
        return self._scenes[key]
