"""The histogram of Zhu et al., as NeuSample measures it: a network that predicts all cells."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Knob
from harness.fitting.module_method import ModuleMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.fitting.targets import Targets
from harness.nets.conditional import ConditionalMLP
from harness.nets.mlp import split_rows
from harness.nets.squares import Squares

LOSSES = ("mse", "kl")
FORMS = {"loss": LOSSES}
_CHUNK = {"cpu": 1024}
"""Rows at a time: a row has a thousand outputs, and a thousand rows of them stay in cache."""
_CHUNK_ELSEWHERE = 1 << 16


class Cells(nn.Module):
    """Network of the condition whose outputs are the densities of square cells."""

    def __init__(self, net: ConditionalMLP, resolution: int, uniform: float):
        super().__init__()
        self.net, self.resolution = net, resolution
        squares = Squares.covering(resolution)
        # Of all constants on a cell that is partly inside, density times the root of its
        # inner share has least variance. Zero in cells that the disk does not reach.
        root = squares.spread(squares.share.sqrt())
        self.register_buffer("root", root, persistent=False)
        self.floor = uniform / math.pi

    def forward(self, condition: Tensor) -> Tensor:
        """Predicted target density [N, R * R] as if every cell were whole."""
        return nn.functional.softplus(self.net(condition)) + self.floor

    def mass(self, condition: Tensor) -> Tensor:
        """Unnormalised masses [N, R (y), R (x)] that samples are drawn from.

        [1, R, R] for one condition N times, with which whoever integrates asks.
        """
        if len(condition) > 1 and bool((condition == condition[:1]).all()):
            condition = condition[:1]
        whole = nn.functional.softplus(self.net(condition))
        mass = torch.addcmul(self.floor * self.root, whole, self.root)
        return mass.unflatten(-1, (self.resolution, -1))


class Histogram(ModuleMethod):
    r"""A network F+2-32-32-32-1024 (ReLU, softplus) of the raw condition predicts a histogram.

    Zhu et al. (2021) predict a picture of a luminaire and sample it; here the picture is of
    p* on ``resolution`` x ``resolution`` cells of [-1, 1]^2,

    .. math:: p(\omega) = \frac{h_c}{A \sum_{c'} h_{c'}}, \quad \omega \in c

    with cells outside the disk left out. ``loss="mse"`` regresses the unnormalised outputs to
    the pdf in squared error over the disk (the release: to the BRDF itself, whose scale then
    decides which conditions matter); ``"kl"`` maximises the likelihood of directions from p*.

    ``uniform`` is added to all cells as a share of the uniform density: softplus of a network
    falls below the least single-precision number where it saw nothing, and p > 0 is owed
    wherever f > 0.

    Uses two uniforms: ``u[0]`` picks a row of cells by its sum, then a place in the row,
    ``u[1]`` the cell of the row and the place in that. Rim cells reach over the rim; what is
    drawn there is an invalid sample of the histogram's own density.
    """

    name = "histogram"
    uniforms = 2
    learning_rate = 3e-3
    weight_decay = 0.0
    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("resolution", (8, 16, 32, 64), "cells a side"),
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self,
        resolution: int = 32,
        width: int = 32,
        layers: int = 3,
        loss: str = "mse",
        uniform: float = 0.01,
        precision: str = "float32",
    ):
        if loss not in LOSSES:
            raise InputError(f"{self.name}: loss is '{loss}'; expected one of {LOSSES}")
        if resolution < 2 or uniform <= 0:
            raise InputError(
                f"{self.name}: expected resolution >= 2 and uniform > 0,"
                f" not {resolution} and {uniform}"
            )
        self.resolution, self.width, self.layers = resolution, width, layers
        self.loss_name, self.uniform = loss, uniform
        self.precision = checked_precision(precision, self.name)

    def build(self, material: Material) -> Cells:
        """A fresh network."""
        hidden = [self.width] * self.layers
        net = ConditionalMLP(material, hidden, self.resolution**2, frequencies=0)
        # The uniform density to begin with, not the 0.69 of softplus(0).
        nn.init.constant_(net.mlp.layers[-1].bias, math.log(math.expm1(1 / math.pi)))
        return Cells(net, self.resolution, self.uniform)

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D] at ``wo`` [B, D, 2] of the square."""
        mass = self.module.mass(condition)
        total = mass.sum((1, 2))[:, None] * (2 / self.resolution) ** 2
        mass = mass.expand(len(condition), -1, -1)
        return (mass.flatten(1).gather(1, self._cell(wo)[0]) / total).log()

    def loss(self, targets: Targets, budget: Budget, generator: torch.Generator) -> Tensor:
        """Squared error over the disk, or the likelihood."""
        if self.loss_name == "kl":
            return super().loss(targets, budget, generator)
        condition, wo, wanted, weight = targets.mixed(
            budget.conditions, budget.directions, generator
        )
        found = self.module(condition).gather(1, self._cell(wo)[0])
        return (weight * (found - wanted).square()).mean()

    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.reference_pdf`."""
        inside = ((wo >= -1) & (wo <= 1)).all(-1)
        return torch.where(inside, super().reference_pdf(condition, wo), 0)

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        # Other precisions are answered as the numbers they hold: the network is in single.
        condition, u = condition.float(), u.float()
        n = self.resolution
        wo, pdf = condition.new_empty(len(u), 2), condition.new_empty(len(u))
        start = 0
        with torch.inference_mode():
            chunk = _CHUNK.get(condition.device.type, _CHUNK_ELSEWHERE)
            for rows, v in zip(split_rows(condition, chunk), split_rows(u, chunk), strict=True):
                mass, row_sums = self._masses(rows)
                row, y = _pick(row_sums, v[:, 0])
                cells = mass.gather(1, row[:, None, None].expand(-1, 1, n))[:, 0]
                column, x = _pick(cells, v[:, 1])
                place = torch.stack([column + x, row + y], -1) * (2 / n) - 1
                end = start + len(rows)
                wo[start:end] = place
                pdf[start:end] = self._density(mass, row_sums, place)
                start = end
        return DiskSample(wo, pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        condition, wo = condition.float(), wo.float()
        pdf = condition.new_empty(len(wo))
        start = 0
        with torch.inference_mode():
            chunk = _CHUNK.get(condition.device.type, _CHUNK_ELSEWHERE)
            for rows, at in zip(split_rows(condition, chunk), split_rows(wo, chunk), strict=True):
                pdf[start : start + len(rows)] = self._density(*self._masses(rows), at)
                start += len(rows)
        return pdf

    def _masses(self, condition: Tensor) -> tuple[Tensor, Tensor]:
        """:meth:`Cells.mass` [N, R, R], and its sums over the columns [N, R]."""
        mass = self.module.mass(condition)
        n, row_sums = len(condition), mass.sum(2)
        return mass.expand(n, -1, -1), row_sums.expand(n, -1)

    def _density(self, mass: Tensor, row_sums: Tensor, wo: Tensor) -> Tensor:
        cell, outside = self._cell(wo)
        value = mass.flatten(1).gather(1, cell[:, None])[:, 0]
        total = row_sums.sum(1) * (2 / self.resolution) ** 2
        return torch.where(outside, 0, value / total)

    def _cell(self, wo: Tensor) -> tuple[Tensor, Tensor]:
        """Cell numbers of points [..., 2], and whether they are outside the square."""
        at = (wo + 1) * (self.resolution / 2)
        # The far edge belongs to the last cell. Off the square, any number that exists will do.
        inside = ((wo >= -1) & (wo <= 1)).all(-1)
        cell = torch.where(inside[..., None], at, 0).long().clamp(max=self.resolution - 1)
        x, y = cell.unbind(-1)
        return y * self.resolution + x, (wo.abs() > 1).any(-1)


def _pick(mass: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Which of ``mass`` [N, R] >= 0 ``u`` [N] falls on, and where in it, [0, 1)."""
    cdf = mass.cumsum(1)
    # Scaled by the cdf's own end: u < 1 stays below it, and cells without mass are passed over.
    at = u[:, None] * cdf[:, -1:]
    index = (cdf <= at).sum(1, keepdim=True).clamp(max=mass.shape[1] - 1)
    own = mass.gather(1, index)
    # Place from the cell's far edge: rounding of the running sum may put it a bit off [0, 1).
    place = 1 - (cdf.gather(1, index) - at) / own
    return index[:, 0], place[:, 0].clamp(0, 1 - 2**-24)
