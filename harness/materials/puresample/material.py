"""A material learned from walks."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.material import ColumnMaterial
from harness.core.protocol.disk import REC709
from harness.materials.neural.column_lookup import ColumnTable
from harness.materials.puresample import sampling
from harness.materials.puresample.network import (
    CHANNELS,
    PureSample,
    albedo_columns,
    at_columns,
)
from harness.nets.compiled_network import usable
from harness.nets.encoding import Encoded


class PureSampleMaterial(ColumnMaterial):
    r"""A trained :class:`PureSample`: condition ``[latent vector, wi.xy]``, no address.

    .. math:: f_c = \rho(\omega_o\,|\,\omega_i, c)\,\alpha_c(\omega_i)

    (eq. 1), with the exact density of the flow's steps: each channel is an inversion. f is
    positive on the whole disk and its integral over it is the albedo, by construction.

    Its own sampler (:meth:`native_sample_columns`) is the mixture of the channels' flows in
    proportion to their albedos' luminance: the target itself, normalised. A sample costs one flow
    forward and the density two inversions more. :meth:`channel_sample_columns` has one channel's.
    """

    record: Mapping[str, Any] = MappingProxyType({})
    """How it came to be, where its file says so."""

    renders_in_columns = True

    def __init__(self, name: str, network: PureSample, identity: dict[str, Any]):
        self.name = name
        self.network = network.eval().requires_grad_(False)
        self._identity = identity
        self.n_features = network.architecture.features
        self._tables: dict[Any, ColumnTable] = {}

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return self._identity

    # --- conditions --------------------------------------------------------------------

    def places(self, uv: Tensor) -> Tensor:
        """Latent vectors [N, features] at ``uv`` [N, 2]."""
        with torch.no_grad():
            return self.network.features(uv)

    def condition_columns(self, si: Any) -> Columns:
        """The condition at surface interactions, as a renderer meets it."""
        wi = [si.wi.x, si.wi.y]
        if self.network.texture is None:
            return wi
        array = type(si.uv.x)
        if array not in self._tables:
            side = self.network.architecture.resolution
            self._tables[array] = ColumnTable(self.network.texture, side, 1, array)
        return [*self._tables[array].lookup([si.uv.x, si.uv.y]), *wi]

    # --- reflectance -------------------------------------------------------------------

    def eval_columns(self, c: Columns, wo: Columns) -> Columns:
        """BSDF without cosine over columns: three of them."""
        features, wi = c[:-2], c[-2:]
        albedo = albedo_columns(self.network, features, wi)
        inside = dr.fma(wo[0], wo[0], wo[1] * wo[1]) < 1
        found = self._densities(features, wi, wo)
        return [dr.select(inside, p * a, 0) for p, a in zip(found, albedo, strict=True)]

    def albedo(self, condition: Tensor) -> Tensor:
        """Integral [N, 3] of f over the disk at ``condition`` [N, C]."""
        with torch.no_grad():
            return self.network.albedo(condition[:, :-2], condition[:, -2:])

    def _densities(self, features: Columns, wi: Columns, wo: Columns) -> Columns:
        """Of the three channels; one inversion where they are alike."""
        array = type(wi[0])
        index = dr.uint32_array_t(array)

        def of(channel: int) -> Float:
            at = at_columns(self.network, features, index(channel), wi)
            return sampling.density(self.network, at, wo)

        if self.network.architecture.grey:
            return [of(0)] * CHANNELS
        if usable(Encoded.plain([*features, *wi, *wo])) is not None:
            return [of(channel) for channel in range(CHANNELS)]

        # A loop of three, so that Dr.Jit's kernel has the steps once.
        def body(k: Any, r: Float, g: Float, b: Float) -> tuple:
            at = at_columns(self.network, features, k, wi)
            p = sampling.density(self.network, at, wo)
            old = (r, g, b)
            return k + 1, *(dr.select(k == i, p, old[i]) for i in range(CHANNELS))

        start = index(0), array(0), array(0), array(0)
        _, *found = dr.while_loop(
            start, lambda k, *rest: k < CHANNELS, body, mode="symbolic", label="channels"
        )
        return found

    # --- samplers ----------------------------------------------------------------------

    def native_sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """Directions and density ``(x, y, pdf)`` of the mixture over channels; three uniforms."""
        weight = self._weights(c)
        channel = dr.select(u[2] < weight[0], 0, dr.select(u[2] < weight[0] + weight[1], 1, 2))
        first = [type(u[2])(0), weight[0], weight[0] + weight[1]]
        low = dr.select(channel == 0, first[0], dr.select(channel == 1, first[1], first[2]))
        width = dr.select(channel == 0, weight[0], dr.select(channel == 1, weight[1], weight[2]))
        # What is left of the third uniform picks a lobe of the base; rounding may reach one.
        rest = dr.minimum((u[2] - low) / width, 1 - 2**-24)
        index = dr.uint32_array_t(type(u[2]))
        x, y, _ = self.channel_sample_columns(c, [u[0], u[1], rest], index(channel))
        return x, y, self.native_pdf_columns(c, [x, y])

    def native_pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """Density per disk area of :meth:`native_sample_columns`."""
        found = self._densities(c[:-2], c[-2:], wo)
        return _sum(w * p for w, p in zip(self._weights(c), found, strict=True))

    def channel_sample_columns(
        self, c: Columns, u: Columns, channel: Any
    ) -> tuple[Float, Float, Float]:
        """Directions and density ``(x, y, pdf)`` of the flow of ``channel``, an integer column."""
        at = at_columns(self.network, c[:-2], channel, c[-2:])
        return sampling.sample(self.network, at, u)

    def channel_pdf_columns(self, c: Columns, wo: Columns, channel: Any) -> Float:
        """Density per disk area of :meth:`channel_sample_columns`."""
        at = at_columns(self.network, c[:-2], channel, c[-2:])
        return sampling.density(self.network, at, wo)

    def brightest_columns(self, c: Columns) -> Any:
        """The channel of the highest albedo, an integer column: the published choice."""
        r, g, b = albedo_columns(self.network, c[:-2], c[-2:])
        index = dr.uint32_array_t(type(r))
        return dr.select((r >= g) & (r >= b), index(0), dr.select(g >= b, index(1), index(2)))

    def _weights(self, c: Columns) -> Columns:
        """Shares of the channels in the mixture: by the luminance that each carries."""
        albedo = albedo_columns(self.network, c[:-2], c[-2:])
        carried = [w * a for w, a in zip(REC709, albedo, strict=True)]
        total = _sum(carried)
        return [v / total for v in carried]


def _sum(values: Any) -> Any:
    first, *rest = values
    for value in rest:
        first = first + value
    return first
