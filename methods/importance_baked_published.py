"""BSDF importance baking as published: networks guess direction, weight, value and density."""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, Knob, Method
from harness.importance_maps.baked_method import BakedMethod
from harness.importance_maps.database import Maps
from harness.importance_maps.training import MapBatches
from harness.nets.blobs import TableEncoder
from harness.nets.mlp import MLP

_LAMBDA = 0.4
"""Of the weight's loss beside the direction's, the paper's section 5.2."""
_SMAPE = 0.01


class ThreeNetworks(nn.Module):
    """Networks of the paper's Figures 8 and 10; encodings of its Table 1.

    ``sampling`` (condition, uniforms) -> direction 2, weight 3; ``evaluation`` (condition,
    direction) -> 3; ``density`` (condition, direction) -> 1. What is positive is predicted by its
    logarithm v, so that log(1 + e^v) of the losses is softplus.
    """

    def __init__(self, material: Material, width: int, layers: int):
        super().__init__()
        self.encoder = TableEncoder(material)
        inputs = self.encoder.width + 2 * self.encoder.direction.size
        self.sampling, self.evaluation, self.density = (
            MLP([inputs, *[width] * layers, outputs]) for outputs in (5, 3, 1)
        )


class ImportanceBakedPublished(BakedMethod):
    r"""Three networks, as Bai et al. (2023): **biased**, and its pdf is no density.

    A sampling network learns the importance maps: (condition, :math:`\xi`) to the direction and
    the weight f / p (eq. 6). An evaluation network answers :meth:`eval` (eq. 7; here without
    cosine, as everywhere in the harness), a pdf network :meth:`pdf` (eq. 8; per disk area).
    Encodings are the paper's Table 1, losses its section 5.2: L1 on directions and, times 0.4,
    on log(1 + weight); symmetric relative error of values; L1 of log(1 + pdf). ``width`` 64 and
    ``layers`` 6 are the paper's (128 for layered materials).

    Estimates are what the sampling network says they are, off by its error; a direction that it
    puts off the disk is lost, which darkens grazing, highly specular slices (the paper's
    Figure 18). ``exact_pdf`` is false: nothing is divided by :meth:`pdf`, which only weighs
    strategies in multiple importance sampling.

    Deviations: the sampling network learns the map between the cells' centres too, by bilinear
    interpolation. Of centres alone, a grid, encodings of frequencies up to 2^11 tell nothing about
    the uniforms that a render draws: after 2000 steps three quarters of the samples were off the
    disk. Batches draw half of their directions for the last two networks from the maps
    (the paper: pixels, uniformly); Adam for all three (the paper: Ranger for two); features that
    are not in Table 1 have a one-blob encoding of 4. Uses two uniforms.
    """

    name = "importance-baked-published"
    uniforms = 2
    exact_pdf = False
    note: ClassVar[str] = "biased, as published"
    """What is said of every fit."""
    learning_rate = 2e-3
    weight_decay = 0.0

    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("width", (16, 32, 64, 128), "neurons of a hidden layer"),
        Knob("layers", (2, 4, 6), "hidden layers"),
        Knob("slices", (256, 512, 1024, 2048), "importance maps baked"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self,
        width: int = 64,
        layers: int = 6,
        slices: int = 1024,
        resolution: int = 32,
        kind: str = "optimal-transport",
        database: str = "",
    ):
        if min(width, layers, slices) < 1:
            raise InputError(
                f"{self.name}: expected at least one of width, layers and slices,"
                f" not {width}, {layers} and {slices}"
            )
        self.width, self.layers = width, layers
        self.bake_with(slices, resolution, kind, database)

    def build(self, material: Material) -> ThreeNetworks:
        """See :meth:`ModuleMethod.build`."""
        return ThreeNetworks(material, self.width, self.layers)

    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.reference_pdf`: a guess has no other route to it."""
        return None

    # --- fitting -----------------------------------------------------------------------

    def meet(self, condition: Tensor) -> None:
        """See :meth:`BakedMethod.meet`."""
        self.module.encoder.fit_range(condition)

    def notes(self, maps: Maps) -> str:
        """See :meth:`BakedMethod.notes`."""
        return f"{super().notes(maps)}; {self.note}"

    def baked_loss(
        self, batches: MapBatches, budget: Budget, generator: torch.Generator, left: float
    ) -> Tensor:
        """Sum of the three losses, all on one batch; the networks share no parameter."""
        condition, _, _, row = batches.draw(budget.conditions, budget.directions, generator)
        shape = budget.conditions, budget.directions, 2
        u = torch.rand(shape, generator=generator).to(condition.device)
        wo = between(batches.wo[row], u)
        encoded = self.module.encoder(condition)[:, None].expand(-1, u.shape[1], -1)
        weight = batches.at(row, wo)[1]
        found, log_weight = self.map(encoded, u)
        sampling = (found - wo).abs().sum(-1).mean()
        sampling = sampling + _LAMBDA * (log_weight - weight.log1p()).abs().sum(-1).mean()
        there = batches.half_even(wo, generator)
        value, _, pdf = batches.at(row, there)
        seen = torch.cat([encoded, self.module.encoder.point((there + 1) / 2)], -1)
        guess = self.module.evaluation(seen).exp()
        size = guess.abs().sum(-1).detach() + value.abs().sum(-1)
        evaluation = ((guess - value).abs().sum(-1) / (size + _SMAPE)).mean()
        log_pdf = nn.functional.softplus(self.module.density(seen)[..., 0])
        return sampling + evaluation + (log_pdf - pdf.log1p()).abs().mean()

    def map(self, encoded: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Directions [..., 2] and log(1 + weight) [..., 3] at uniforms ``u`` [..., 2]."""
        seen = torch.cat([encoded, self.module.encoder.point(u)], -1)
        out = self.module.sampling(seen)
        return out[..., :2], nn.functional.softplus(out[..., 2:])

    # --- sampling ----------------------------------------------------------------------

    def sample_weighted_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float, Any]:
        """See :meth:`ColumnMethod.sample_weighted_columns`."""
        encoded = self.module.encoder.columns(c)
        point, _ = self.module.encoder.point_columns(list(u[:2]))
        x, y, *raw = self.module.sampling.columns(encoded + point)
        inside = dr.fma(x, x, y * y) < 1
        # Off the disk there is nothing to be seen, whatever the network says of it.
        weight = [dr.select(inside | dr.isnan(v), dr.exp(v), 0) for v in raw]
        return x, y, self._pdf(c, encoded, x, y), weight

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`; the density is the pdf network's guess."""
        return self.sample_weighted_columns(c, u)[:3]

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`; a guess."""
        return self._pdf(c, self.module.encoder.columns(c), *wo)

    def _pdf(self, c: Columns, encoded: Columns, x: Float, y: Float) -> Float:
        point, _ = self.module.encoder.point_columns([dr.fma(0.5, v, 0.5) for v in (x, y)])
        guess = dr.exp(self.module.density.columns(encoded + point)[0])
        inside = dr.fma(x, x, y * y) < 1
        return dr.select(inside | dr.isnan(guess), guess, 0)

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.eval`: the evaluation network's guess."""
        if len(condition) == 0:
            return condition.new_empty(0, 3)
        with torch.inference_mode():
            c, (x, y) = columns_of(condition), columns_of(wo)
            encoder = self.module.encoder
            point, _ = encoder.point_columns([dr.fma(0.5, v, 0.5) for v in (x, y)])
            raw = self.module.evaluation.columns(encoder.columns(c) + point)
            inside = dr.fma(x, x, y * y) < 1
            f = [dr.select(inside | dr.isnan(v), dr.exp(v), 0) for v in raw]
            return tensor_of(*f, rows=len(condition))


def between(maps: Tensor, u: Tensor) -> Tensor:
    """Maps [B, R, R, 2] at uniforms ``u`` [B, D, 2]: bilinear, constant past the outer centres."""
    n = maps.shape[1]
    at = (u * n - 0.5).clamp(0, n - 1)
    low = at.long().clamp(max=max(n - 2, 0))
    high = (low + 1).clamp(max=n - 1)
    part = at - low
    flat = maps.flatten(1, 2)

    def corner(row: Tensor, column: Tensor) -> Tensor:
        return flat.gather(1, (row * n + column)[..., None].expand(-1, -1, 2))

    (x0, y0), (x1, y1) = low.unbind(-1), high.unbind(-1)
    below = torch.lerp(corner(y0, x0), corner(y0, x1), part[..., :1])
    above = torch.lerp(corner(y1, x0), corner(y1, x1), part[..., :1])
    return torch.lerp(below, above, part[..., 1:])


class ImportanceBakedOneNetwork(ImportanceBakedPublished):
    """The published sampling network alone: **biased**; f and pdf are the material's own.

    What the paper's Figure 15 calls "BSDF sampling network + GT evaluation and PDF". **Biased**
    as ``importance-baked-published`` is, but light samples are not. Needs a material that has
    a sampler of its own.
    """

    name = "importance-baked-one-network"

    def supports(self, material: Material) -> tuple[bool, str]:
        """Whether the material has a density to weigh strategies by."""
        if not callable(getattr(material, "native_pdf_columns", None)):
            return False, f"material '{material.name}' has no density of its own"
        return True, ""

    def _pdf(self, c: Columns, encoded: Columns, x: Float, y: Float) -> Float:
        return self.material.native_pdf_columns(c, [x, y])

    eval = Method.eval
