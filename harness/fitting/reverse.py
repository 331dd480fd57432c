r"""Fits by the samples of a map itself: reverse KL, which needs f and its gradient and no table.

A map T of normal points z has the density :math:`N(z) / \det J` where it is one to one, so

.. math:: KL(p \,\|\, p^*) = E_z[\log N(z) - \log(f(T(z))\,\det J(z))] + \log A

with A the integral of f, which no parameter changes. Its gradient goes through the direction
T(z) into f. A mode of p* that no sample meets does not count: reverse KL may leave it out, where
a likelihood of directions drawn from p* cannot.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget

LEAST = 1e-14
"""Added to f before its logarithm, as the authors do: nothing has no logarithm."""
LOOKED = 64
"""Directions at which a condition has to be black to count as black."""


@dataclass
class Pool:
    """Conditions [P, C] to fit at, those without any reflection left out and counted."""

    condition: Tensor
    seconds: float
    black: int

    @property
    def notes(self) -> str:
        """What was left out; empty if nothing."""
        return f"{self.black} black conditions left out" if self.black else ""

    @classmethod
    def draw(cls, material: Material, budget: Budget, generator: torch.Generator) -> Pool:
        """``budget.pool`` random conditions of ``material``.

        Raises:
            InputError: all of them are black.
        """
        start = time.perf_counter()
        condition = material.conditions(budget.pool, generator, budget.device)
        u = torch.rand(1, LOOKED, 2, generator=generator).to(condition.device)
        lit = (material.target_grid(condition, square_to_disk(u)) > 0).any(1)
        if not lit.any():
            raise InputError(
                f"material '{material.name}' is black in all {budget.pool} conditions drawn;"
                " expected light to be reflected in some"
            )
        return cls(condition[lit], time.perf_counter() - start, int((~lit).sum()))

    def batch(self, count: int, generator: torch.Generator) -> Tensor:
        """``count`` of the conditions, [count, C]."""
        row = torch.randint(len(self.condition), (count,), generator=generator)
        return self.condition[row.to(self.condition.device)]


def stratified_uniforms(
    rows: int, directions: int, generator: torch.Generator, device: torch.device | str
) -> Tensor:
    """Uniforms [rows, D, 2] in [0, 1): one in each cell of a square grid, D the largest square."""
    side = math.isqrt(directions)
    index = torch.arange(side, dtype=torch.float32)
    corner = torch.stack(torch.meshgrid(index, index, indexing="ij"), -1).reshape(1, -1, 2)
    u = (corner + torch.rand(rows, side * side, 2, generator=generator)) / side
    # The sum may round up to one.
    return u.clamp(max=1 - torch.finfo(u.dtype).eps / 2).to(device)


def normal_of_uniforms(u: Tensor) -> Tensor:
    """Standard normal points [..., 2] from uniforms [..., 2]: Box and Muller (1958)."""
    # 1 - u is at least 2^-24, so the logarithm is finite.
    radius = (-2 * torch.log1p(-u[..., 0])).sqrt()
    turn = 2 * math.pi * u[..., 1]
    return torch.stack([radius * turn.cos(), radius * turn.sin()], -1)


def target_of(material: Material, condition: Tensor, wo: Tensor) -> Tensor:
    """The target [B, D] of ``condition`` [B, C] at ``wo`` [B, D, 2], differentiable by ``wo``."""
    rows = condition[:, None].expand(-1, wo.shape[1], -1).reshape(-1, condition.shape[1])
    return _Target.apply(wo.reshape(-1, 2), rows, material).view(wo.shape[:2])


class _Target(torch.autograd.Function):
    """A material's target with the gradient that the material gives."""

    @staticmethod
    def forward(ctx: FunctionCtx, wo: Tensor, condition: Tensor, material: Material) -> Tensor:
        value, slope = material.target_gradient(condition, wo)
        ctx.save_for_backward(slope)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None, None]:
        (slope,) = ctx.saved_tensors
        return grad[:, None] * slope, None, None
