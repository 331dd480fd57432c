"""A family: one reflectance model whose parameters are columns of the condition."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.columns.material import ColumnMaterial
from harness.core.protocol.disk import square_to_disk
from harness.materials.families.parameters import Parameter, check
from harness.materials.families.slices import slices

SWATCHES = 8
"""Tiles per side of the board on which a family of more than two free parameters is laid out."""


class Family(ColumnMaterial):
    """A parametric BSDF; condition ``[free parameters, wi.xy]``, no address.

    ``model`` are all parameters of the model in their order, ``fixed`` those that have one
    value here, ``parameters`` the others, which are the features of the condition; ``off``
    are those of its effects that it does without.

    A subclass gives :meth:`eval_columns` and the sampler that the model brings along, which
    ``methods/native.py`` uses.
    """

    family: ClassVar[str]
    model: ClassVar[tuple[Parameter, ...]]
    n_address = 0

    def __init__(self, name: str, fix: Mapping[str, float], identity: dict[str, Any]):
        check(self.model, fix, f"material '{name}'")
        self.name, self._identity = name, identity
        self.off: frozenset[str] = frozenset()
        chosen = {p.name: fix.get(p.name, p.default) for p in self.model}
        self.fixed = {key: float(value) for key, value in chosen.items() if value is not None}
        self.parameters = tuple(p for p in self.model if p.name not in self.fixed)
        self.n_features = len(self.parameters)

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return {**self._identity, **({"without": sorted(self.off)} if self.off else {})}

    def with_effects(self, effects: frozenset[str]) -> Family:
        """See :meth:`Material.with_effects`."""
        off = self.effects - effects
        if off == self.off:
            return self
        other = copy.copy(self)
        other.off = off
        return other

    # --- conditions --------------------------------------------------------------------

    def conditions(self, n: int, generator: torch.Generator, device: str = "cpu") -> Tensor:
        """Rows [n, C]: every free parameter drawn over its range, ``wi`` uniform on the disk."""
        u = torch.rand(n, self.n_features + 2, generator=generator).to(device)
        drawn = [p.at(u[:, i, None]) for i, p in enumerate(self.parameters)]
        return torch.cat([*drawn, square_to_disk(u[:, self.n_features :])], 1)

    def places(self, uv: Tensor) -> Tensor:
        """Free parameters [N, P] of the family laid out over a surface.

        One or two vary with u and v over their whole ranges, once from one whole number to the
        next: scenes repeat their textures. More make a board of
        ``SWATCHES`` x ``SWATCHES`` tiles, each of which has the parameters of one point of a
        low-discrepancy sequence.
        """
        if not self.parameters or len(uv) == 0:
            return uv.new_empty(len(uv), self.n_features)
        if self.n_features <= 2:
            uv = uv - uv.floor()
            return torch.stack([p.at(uv[:, i]) for i, p in enumerate(self.parameters)], 1)
        return self._board().to(uv)[_tile(uv)]

    def condition_columns(self, si: Any) -> Columns:
        """The condition at surface interactions, as a renderer meets it."""
        n = max(dr.width(si.uv), dr.width(si.wi))
        if not self.parameters:
            return [si.wi.x, si.wi.y]
        uv = [dr.repeat(c, n) if dr.width(c) < n else c for c in (si.uv.x, si.uv.y)]
        return [*columns_of(self.places(tensor_of(*uv, rows=n))), si.wi.x, si.wi.y]

    def values(self, c: Columns) -> dict[str, Float]:
        """All parameters of the model by name, those that are fixed as arrays of one element."""
        free = {p.name: column for p, column in zip(self.parameters, c, strict=False)}
        array = type(c[-1])
        return {p.name: free.get(p.name, array(self.fixed.get(p.name, 0))) for p in self.model}

    # --- reflectance -------------------------------------------------------------------

    @abstractmethod
    def eval_columns(self, c: Columns, wo: Columns, seed: int = 0) -> Any:
        """BSDF without cosine, three columns, at condition columns and ``wo = [x, y]``.

        ``seed`` chooses the random walks, where f is estimated by walks; a family in closed
        form ignores it.
        """

    def evaluator(self, c: Columns, seed: int) -> Callable[[Any, Columns, Columns], Any]:
        """f as :func:`slices` evaluates it: ``(row, columns of those rows, wo) -> rgb``.

        ``row`` are indices into ``c``. A family overrides it whose directions of one condition
        can share work.
        """
        return lambda row, wide, wo: self.eval_columns(wide, wo, seed)

    @abstractmethod
    def native_sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """A sampler of the model's own: ``(x, y, pdf)`` per disk area, from three uniforms.

        Its density is known exactly, and positive wherever f is. Invalid samples lie off the disk.
        """

    @abstractmethod
    def native_pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """Density per disk area of :meth:`native_sample_columns`."""

    def slices(self, condition: Tensor, resolution: int, seed: int) -> Tensor:
        """Mean of f over the cells of a grid on the disk's square: rgb [N, R, R, 3].

        See :func:`harness.materials.families.slices.slices`.
        """
        return slices(self, condition, resolution, seed)

    def _board(self) -> Tensor:
        """Parameters [SWATCHES^2, P] of the tiles."""
        # The plastic number's generalisation: the root of g^(P + 1) = g + 1.
        g = 2.0
        for _ in range(64):
            g = (1 + g) ** (1 / (self.n_features + 1))
        tile = torch.arange(1, SWATCHES**2 + 1, dtype=torch.float64)
        columns = [p.at((0.5 + tile * g ** -(i + 1)) % 1) for i, p in enumerate(self.parameters)]
        return torch.stack(columns, 1)


def _tile(uv: Tensor) -> Tensor:
    """Which tile [N] of the board; it repeats beyond the unit square."""
    column, row = (uv.remainder(1) * SWATCHES).long().clamp(max=SWATCHES - 1).unbind(1)
    return row * SWATCHES + column
