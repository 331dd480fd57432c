"""What a check says about one property in one case."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor


@dataclass(frozen=True)
class Finding:
    """One property, one case: holds or does not.

    ``message`` is the measured number, or what is wrong; ``worst`` the worst input found
    with the number it gave and the one it should have given, by name.
    """

    property: str
    case: str
    ok: bool
    message: str
    worst: dict[str, Any] = field(default_factory=dict)

    def line(self) -> str:
        """The finding on one line."""
        text = (
            f"{'pass' if self.ok else 'FAIL'}  {self.property:<16} {self.case:<12} {self.message}"
        )
        if self.worst and not self.ok:
            text += "; worst: " + ", ".join(f"{k} {v}" for k, v in self.worst.items())
        return text


def rounded(value: Tensor | float) -> Any:
    """A tensor or number as short plain data for ``worst``."""
    if isinstance(value, Tensor):
        value = value.detach().to("cpu", torch.float64)
        if value.ndim:
            return "(" + ", ".join(f"{v:.7g}" for v in value.ravel().tolist()) + ")"
        value = value.item()
    return f"{value:.7g}"
