"""Parametric families: reflectance models whose parameters are part of the condition.

``FAMILIES`` says where each is; neither Mitsuba nor Dr.Jit is loaded before one is made.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.materials.families import parameters

PACKAGE = "harness.materials.families"


@dataclass(frozen=True)
class Described:
    """Where a family is: ``class_name`` in a module of this package; ``about`` in one line."""

    about: str
    module: str
    class_name: str
    model: parameters.Model
    by_walks: bool = False
    """Whether f is a mean over random walks, whose number may be given."""

    @property
    def file(self) -> Path:
        """The file that determines the family, with what it imports."""
        return Path(__file__).parent / f"{self.module}.py"

    def check(self, fix: Mapping[str, Any], where: str) -> None:
        """Refuse values for what is no parameter of the model, or out of its bounds."""
        parameters.check(self.model, fix, where)

    def make(
        self, name: str, fix: Mapping[str, float], identity: dict[str, Any], **options: Any
    ) -> Any:
        """The :class:`~harness.materials.families.base.Family`; ``options`` as it takes them.

        Raises:
            InputError: ``fix`` names no parameter of the model, or is out of its bounds.
        """
        module = importlib.import_module(f"{PACKAGE}.{self.module}")
        return getattr(module, self.class_name)(name, fix, identity, **options)


FAMILIES: dict[str, Described] = {
    "disney": Described(
        "Disney's principled BSDF over metallic and roughness",
        "disney",
        "Disney",
        parameters.DISNEY,
    ),
    "ggx-conductor": Described(
        "multiple-bounce GGX conductor over roughness and colour, by random walks",
        "conductor",
        "Conductor",
        parameters.GGX_CONDUCTOR,
        by_walks=True,
    ),
    "layered": Described(
        "rough dielectric over a scattering medium over a diffuse base, by random walks",
        "layered",
        "Layered",
        parameters.LAYERED,
        by_walks=True,
    ),
}
