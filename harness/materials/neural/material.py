"""A neural material of the harness."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.columns.material import ColumnMaterial
from harness.core.protocol import counting
from harness.core.protocol.disk import square_to_disk
from harness.materials.neural.column_lookup import ColumnTable
from harness.materials.neural.network import NeuralMBTF
from harness.materials.neural.offset import STEEPEST

EFFECTS = frozenset({"parallax", "prefiltering"})


class NeuralMaterial(ColumnMaterial):
    """A trained :class:`NeuralMBTF`: condition ``[features, wi.xy]``, no address.

    Stage 1 makes a condition (:meth:`condition_at`, :meth:`condition_columns`), stage 2 is
    :meth:`eval`; both also over columns, where a renderer runs them without leaving Dr.Jit.
    Reflectance is never negative; it may be 0, for the papers end in a ReLU.

    ``effects`` are those that the network can give and that are not switched off:
    ``parallax`` if it has an offset, ``prefiltering`` if it has a pyramid, which then is looked
    up at the footprint of the ray; without it, at its finest level.
    """

    record: Mapping[str, Any] = MappingProxyType({})
    """How it came to be, where its file says so."""

    renders_in_columns = True
    """Conditions and reflectance stay in Dr.Jit, also inside a renderer."""

    def __init__(
        self,
        name: str,
        network: NeuralMBTF,
        identity: dict[str, Any],
        effects: frozenset[str] | None = None,
    ):
        self.name = name
        self.network = network.eval().requires_grad_(False)
        self._identity = identity
        a = network.architecture
        own = {"parallax": a.offset, "prefiltering": a.pyramid}
        self._able = frozenset(effect for effect in EFFECTS if own[effect])
        self.effects = self._able if effects is None else self._able & effects
        self.n_features = a.channels
        self._tables: dict[Any, tuple[ColumnTable, ColumnTable | None]] = {}

    @property
    def prefilters(self) -> bool:
        """Whether a renderer has to say how fast a pixel's ray grows."""
        return "prefiltering" in self.effects

    def with_effects(self, effects: frozenset[str]) -> NeuralMaterial:
        """The same material with only those of its effects; the network is shared."""
        return NeuralMaterial(self.name, self.network, self._identity, self._able & effects)

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        if self.effects == self._able:
            return self._identity
        return {**self._identity, "effects": sorted(self.effects)}

    # --- stage 1 -------------------------------------------------------------------------------

    def condition_at(self, uv: Tensor, wi: Tensor, level: Tensor | None = None) -> Tensor:
        """Conditions [N, C + 2] at ``uv`` [N, 2] seen from ``wi`` [N, 2].

        ``level`` [N] of detail as :func:`textures.level_of` counts it; the finest if not given.
        """
        if len(uv) == 0:
            return uv.new_empty(0, self.n_condition)
        columns = columns_of(level[:, None])[0] if level is not None else None
        with torch.no_grad():
            features = self._features(columns_of(uv), columns_of(wi), columns)
            found = tensor_of(*features, rows=len(uv)).view(len(uv), -1)
        return torch.cat([found, wi.float()], 1)

    def places(self, uv: Tensor) -> Tensor:
        """Features [N, C] at ``uv``, seen from above: there nothing is moved."""
        return self.condition_at(uv, torch.zeros_like(uv))[:, : self.n_features]

    def conditions(self, n: int, generator: torch.Generator, device: str = "cpu") -> Tensor:
        """``n`` random conditions: places uniform, ``wi`` uniform on the disk, levels uniform."""
        u = torch.rand(n, 5, generator=generator).to(device)
        level = None
        if "prefiltering" in self.effects:
            level = u[:, 4] * (self.network.architecture.levels - 1)
        return self.condition_at(u[:, :2], square_to_disk(u[:, 2:4]), level)

    def condition_columns(self, si: Any, spread: float = 0.0) -> Columns:
        r"""The condition at surface interactions, as a renderer meets it.

        The ray is a cone that grows by ``spread``, a pixel's angle in radians, from where it
        last left a surface or the camera. It covers :math:`(t\,s)^2 / \cos\theta_i` of the
        surface, and the footprint's deviation is half the side of the square with that area in uv.
        """
        level = None
        if "prefiltering" in self.effects:
            scale = dr.norm(dr.cross(si.dp_du, si.dp_dv))
            area = dr.square(si.t * spread) / (dr.abs(si.wi.z) * scale)
            # A cone of no width covers a point: log2(0) = -inf is below every level.
            level = dr.log2(self.network.architecture.resolution * dr.sqrt(area))
        wi = [si.wi.x, si.wi.y]
        return [*self._features([si.uv.x, si.uv.y], wi, level), *wi]

    def _features(self, uv: Columns, wi: Columns, level: Float | None) -> Columns:
        net = self.network
        table, offset_table = self._on(type(uv[0]))
        if net.offset is not None and "parallax" in self.effects:
            assert offset_table is not None
            if counting.wanted():
                counting.add("parallax", dr.width(uv[0]))
            cos = _cosine(wi)
            seen = [*wi, cos] if net.architecture.cosines else wi
            (depth,) = net.offset.network.columns([*offset_table.lookup(uv), *seen])
            scale = depth / dr.maximum(cos, STEEPEST)
            uv = [dr.fma(scale, w, v) for w, v in zip(wi, uv, strict=True)]
        return table.lookup(uv, level if "prefiltering" in self.effects else None)

    def _on(self, array: type[Float]) -> tuple[ColumnTable, ColumnTable | None]:
        """The textures as arrays of that type, made on first use."""
        if array not in self._tables:
            net, a = self.network, self.network.architecture
            offset = None
            if net.offset is not None:
                offset = ColumnTable(net.offset.texture, net.offset.side, 1, array)
            self._tables[array] = (
                ColumnTable(net.texture, a.resolution, a.levels, array),
                offset,
            )
        return self._tables[array]

    # --- stage 2 -------------------------------------------------------------------------------

    def eval_columns(self, c: Columns, wo: Columns) -> Columns:
        """BSDF without cosine over columns: three of them."""
        a, (x, y), wi = self.network.architecture, wo, c[-2:]
        cosines = [_cosine(wi), _cosine(wo)]
        half = _half(wi, wo, *cosines) if a.half_vector else []
        seen = [x, y, *wi, *half, *(cosines if a.cosines else [])]
        raw = self.network.decoder.columns([*seen, *c[:-2]])
        inside = x * x + y * y < 1
        if a.output == "log1p":
            raw = [_expm1(v) for v in raw]
        # maximum(v, 0 v), for maximum(v, 0) would turn nan into 0.
        return [dr.select(inside, dr.maximum(v, 0 * v), 0) for v in raw]


def _cosine(w: Columns) -> Float:
    """Of a direction on the disk. Off it there is none; what is made of it there is masked."""
    return dr.sqrt(dr.maximum(1 - w[0] * w[0] - w[1] * w[1], 0))


def _half(wi: Columns, wo: Columns, cos_i: Float, cos_o: Float) -> Columns:
    """:func:`harness.materials.neural.network.half_vector` over columns."""
    total, up = [a + b for a, b in zip(wi, wo, strict=True)], cos_i + cos_o
    squared = total[0] * total[0] + total[1] * total[1] + up * up
    scale = dr.rsqrt(dr.select(squared == 0, 1, squared))
    return [v * scale for v in total]


def _expm1(v: Float) -> Float:
    r"""e^v - 1 without cancellation near 0: :math:`\tanh(v / 2)\,(e^v + 1)`, exactly the same."""
    return dr.select(dr.abs(v) < 0.5, dr.tanh(0.5 * v) * (dr.exp(v) + 1), dr.exp(v) - 1)
