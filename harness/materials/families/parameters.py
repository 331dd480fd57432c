"""The numbers of each family's model, and what may be drawn and fixed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from harness.core.protocol.errors import InputError, nearest


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    Drawn between ``low`` and ``high``: uniformly, or, where ``squared``, as the square of a
    uniform number, which favours small values (as Bai et al. 2023, section 5.1, do for
    roughness). ``fix`` accepts any value in [``least``, ``most``].
    """

    name: str
    low: float
    high: float
    least: float
    most: float
    squared: bool = False
    about: str = ""
    default: float | None = None
    """What it is fixed to unless ``fix`` says otherwise; None: it is free."""

    @property
    def is_roughness(self) -> bool:
        """Whether its lower end makes a lobe narrow."""
        return self.name.startswith(("alpha", "roughness"))

    def at(self, t: Tensor) -> Tensor:
        """Values [...] at ``t`` [...] in [0, 1], such that uniform ``t`` draws from the range."""
        if self.squared:
            low, high = math.sqrt(self.low), math.sqrt(self.high)
            return (low + t * (high - low)).square()
        return self.low + t * (self.high - self.low)


def check(model: tuple[Parameter, ...], fix: Mapping[str, Any], where: str) -> None:
    """Refuse values for parameters that the model does not have, or out of their bounds."""
    known = {p.name: p for p in model}
    for key, value in fix.items():
        if key not in known:
            raise InputError(f"{where}: fix: unknown parameter '{key}'{nearest(str(key), known)}")
        p = known[key]
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and p.least <= value <= p.most):
            raise InputError(
                f"{where}: fix: {key}: expected a number from {p.least:g} to {p.most:g},"
                f" got {value!r}"
            )


Model = tuple[Parameter, ...]

DISNEY: Model = (
    Parameter("metallic", 0.0, 1.0, 0.0, 1.0, about="0 plastic, 1 metal"),
    # Mitsuba's least alpha is 0.001, roughness 0.0316; below it nothing changes.
    Parameter("roughness", 0.1, 1.0, 0.0, 1.0, about="square root of GGX's alpha"),
)

_ALPHA = {"low": 0.01, "high": 1.0, "least": 1e-4, "most": 2.0, "squared": True}
_SHARE = {"low": 0.0, "high": 1.0, "least": 0.0, "most": 1.0}

GGX_CONDUCTOR: Model = (
    Parameter("alpha_x", **_ALPHA, about="GGX's roughness along x"),
    Parameter("alpha_y", **_ALPHA, about="GGX's roughness along y"),
    *(Parameter(f"r0_{k}", **_SHARE, about="reflectance at normal incidence") for k in "rgb"),
)

LAYERED: Model = (
    Parameter("eta", 1.05, 2.0, 1.0, 3.0, about="index of refraction below the interface"),
    Parameter("alpha", **_ALPHA, about="GGX's roughness of the interface"),
    Parameter("sigma_t", 0.0, 5.0, 0.0, 50.0, about="the medium's optical depth"),
    *(Parameter(f"albedo_{k}", **_SHARE, about="of the medium") for k in "rgb"),
    Parameter("base", **_SHARE, about="reflectance of the diffuse base", default=0.8),
)
