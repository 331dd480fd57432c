"""A synthetic reflectance in closed form, written as a grey factor on the disk."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk, luminance
from harness.core.protocol.errors import Unsupported
from harness.core.protocol.material import Material

WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Made:
    """How a hard material is made: ``make(name, identity)``; ``file`` is what determines it."""

    about: str
    file: Path
    make: Callable[[str, dict[str, Any]], Material]


class DiskMaterial(Material):
    """f = factor(condition, wo) x ``colour``, zero outside the disk; plain torch.

    The material need not be reciprocal: neither measured nor neural ones are.
    """

    colour: ClassVar[tuple[float, float, float]] = WHITE

    def __init__(self, name: str, identity: dict[str, Any]):
        self.name, self._identity = name, identity

    @abstractmethod
    def factor(self, condition: Tensor, wo: Tensor) -> Tensor:
        """BSDF [...] of colour one, per steradian, at ``condition`` [..., C], ``wo`` [..., 2].

        Leading axes broadcast. What it gives outside the disk does not count.
        """

    def albedo(self, condition: Tensor) -> Tensor:
        """Integral of :meth:`target` over the disk, [N], in closed form.

        That is the mean of the weights f/p of any correct sampler. Where f is negative it
        differs from the albedo of f itself, which the absolute value of the target does not.
        """
        raise NotImplementedError(f"{self.name} has no albedo in closed form")

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return self._identity

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        return self._lit(condition, wo)[:, None] * wo.new_tensor(self.colour)

    def target_grid(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.target_grid`; what depends on the row alone is found once."""
        return (self._lit(condition[:, None], wo) * luminance(wo.new_tensor(self.colour))).abs()

    def target_gradient(self, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`Material.target_gradient`: always by torch."""
        try:
            return super().target_gradient(condition, wo)
        except Unsupported:
            # Without a path to wo, f is constant in pieces.
            return self.target(condition, wo), torch.zeros_like(wo)

    def _lit(self, condition: Tensor, wo: Tensor) -> Tensor:
        return torch.where(inside_disk(wo), self.factor(condition, wo), 0)
