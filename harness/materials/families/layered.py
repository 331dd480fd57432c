r"""A rough dielectric interface over a medium over a diffuse base (Guo et al. 2018).

Light is followed in optical depth alone, hence "position-free": see :mod:`.layered_walks`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.materials.families import ggx
from harness.materials.families.dielectric import fresnel, masking, pass_through
from harness.materials.families.hashing import generator_at
from harness.materials.families.layered_walks import Cosine, Layers, WayOut, connected, walk
from harness.materials.families.parameters import LAYERED
from harness.materials.families.walks import WalkFamily

NODES = 32
"""Cosines at which a slice tabulates the radiance inside, equidistant in their square root."""
TABLE_WALKS, TABLE_LANES = 8192, 16
"""Walks of a slice's table, and how many lanes share them."""
FACETS = 8
"""Facets that refract ``wo``, for each point of a slice."""


class Layered(WalkFamily):
    r"""Interface of index ``eta`` and GGX roughness ``alpha``; a homogeneous, isotropic medium
    of optical depth ``sigma_t`` (its thickness is one) and single-scattering albedo ``albedo_*``
    (rgb); a Lambertian base of reflectance ``base``, 0.8 unless fixed to something else.

    :meth:`eval` is the interface's reflection in closed form,

    .. math:: f_R = \frac{F D(h)}{(\cos\theta_i + a(\omega_i))(\cos\theta_o + a(\omega_o))},

    and the mean over ``walks`` walks of what comes out of it. A walk enters through a visible
    microfacet of ``wi``. ``wo`` is refracted in by one of its own, to the cosine
    :math:`\mu_o` with the weight :math:`W_o = (1 - F) G_1(\mu_o)`, and every event of the walk,
    of weight T, is connected to it:

    .. math:: f_T = \frac{1}{\eta^2} E\Big[W_o \Big(\sum_\text{medium} T\,\frac{a}{4\pi}
              \frac{e^{-\tau/\mu_o}}{\mu_o} + \sum_\text{base} T\,\frac{\rho}{\pi}
              e^{-\tau/\mu_o}\Big)\Big].

    The factor is radiance's, from :math:`f_t(u, \omega_o) = f_t(\omega_o, u)/\eta^2`. The effect
    ``media`` is the medium: without it light goes straight between interface and base.

    ``native_*_columns`` draw a mirror direction at a visible normal or a cosine lobe, by the
    Fresnel reflectance at ``wi``; :meth:`walk_columns` is the walk itself.
    """

    family = "layered"
    model = LAYERED
    effects = frozenset({"media"})

    def eval_columns(self, c: Columns, wo: Columns, seed: int = 0) -> Any:
        """See :meth:`Family.eval_columns`."""
        layers, wi = self._unpacked(c)
        inside = wo[0] * wo[0] + wo[1] * wo[1] < 1
        out = ggx.above(dr.select(inside, wo[0], 0), dr.select(inside, wo[1], 0))
        rng = self.generator(c, wo, seed)
        inner = connected(wi, WayOut(layers, out), layers, rng, self.walks, inside)
        f = _reflected(wi, out, layers) + inner / (self.walks * layers.eta * layers.eta)
        return dr.select(inside, f, 0)

    def evaluator(self, c: Columns, seed: int) -> Callable[[Any, Columns, Columns], Any]:
        """See :meth:`Family.evaluator`: all directions of a condition share its walks.

        They see the radiance that rises to the interface, a function of one cosine. It is
        tabulated from ``TABLE_WALKS`` walks and interpolated, so that a slice is smooth, and off
        as a whole by what its table is; only the facets that ``wo`` is refracted by are drawn.
        """
        table = self._radiance(c, seed)

        def evaluate(row: Any, wide: Columns, wo: Columns) -> Any:
            layers, wi = self._unpacked(wide)
            inside = wo[0] * wo[0] + wo[1] * wo[1] < 1
            out = ggx.above(dr.select(inside, wo[0], 0), dr.select(inside, wo[1], 0))
            rng, way = self.generator(wide, wo, seed), WayOut(layers, out)
            inner = dr.zeros(type(layers.albedo))
            for _ in range(FACETS):
                mu, weight = way(rng.next_float32(), rng.next_float32())
                inner += weight * _interpolated(table, row, mu)
            f = _reflected(wi, out, layers) + inner / (FACETS * layers.eta * layers.eta)
            return dr.select(inside, f, 0)

        return evaluate

    def _radiance(self, c: Columns, seed: int) -> Any:
        """Radiance at the interface, rgb, at ``NODES`` cosines of each row, row by row."""
        n, array = max(dr.width(column) for column in c), type(c[-1])
        unsigned = dr.uint32_array_t(array)
        lane = dr.arange(unsigned, n * NODES * TABLE_LANES)
        row, node = lane // (NODES * TABLE_LANES), lane // TABLE_LANES % NODES
        wide = [dr.gather(array, column, row) for column in c]
        layers, wi = self._unpacked(wide)
        # The same walks for all nodes: their errors agree, and the table is smooth.
        where = [*self.values(wide).values(), *wide[-2:], array(lane % TABLE_LANES)]
        walks = TABLE_WALKS // TABLE_LANES
        going = dr.full(dr.mask_t(array), True, dr.width(lane))
        mu = dr.square(array(node + 1) / NODES)
        total = connected(wi, Cosine(mu), layers, generator_at(where, seed), walks, going)
        table = dr.block_reduce(dr.ReduceOp.Add, total, TABLE_LANES) / TABLE_WALKS
        dr.eval(table)
        return table

    def walk_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Any]:
        """See :meth:`WalkFamily.walk_columns`."""
        layers, wi = self._unpacked(c)
        rng = generator_at(u, 0)
        first = pass_through(wi, layers.roughness, layers.eta, u[0], u[1])
        reflects = u[2] < first.reflectance
        w = dr.select(reflects, first.mirrored, first.refracted)
        lost = (w.z > 0) != reflects
        weight = dr.select(lost, 0, masking(w.z, layers.alpha))
        cos, inner = walk(w.z, weight, layers, rng, ~(reflects | lost))
        sin, turn = dr.sqrt(dr.maximum(1 - cos * cos, 0)), 2 * math.pi * rng.next_float32()
        sine, cosine = dr.sincos(turn)
        out = ggx.vector(sin * cosine, sin * sine, cos)
        w = dr.select(reflects, w, out)
        weight = dr.select(reflects, weight, inner)
        return *ggx.on_disk(w, dr.max(weight) > 0), weight

    def native_sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`Family.native_sample_columns`."""
        layers, wi = self._unpacked(c)
        x, y = ggx.sample_mixture(wi, layers.roughness, _even_share(wi, layers), u)
        return x, y, self.native_pdf_columns(c, [x, y])

    def native_pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`Family.native_pdf_columns`."""
        layers, wi = self._unpacked(c)
        return ggx.pdf_mixture(wi, layers.roughness, _even_share(wi, layers), wo)

    def _unpacked(self, c: Columns) -> tuple[Layers, Any]:
        """The layers and wi of the rows."""
        v = self.values(c)
        albedo = ggx.vector(v["albedo_r"], v["albedo_g"], v["albedo_b"])
        thickness = v["sigma_t"] if "media" not in self.off else v["sigma_t"] * 0
        return Layers(v["eta"], v["alpha"], thickness, albedo, v["base"]), ggx.above(*c[-2:])


def _reflected(wi: Any, wo: Any, layers: Layers) -> Float:
    """f of the interface's upper side."""
    h = dr.normalize(wi + wo)
    alpha = layers.roughness
    both = (wi.z + ggx.stretched(wi, alpha)) * (wo.z + ggx.stretched(wo, alpha))
    return fresnel(dr.dot(wi, h), layers.eta)[0] * ggx.ndf(h, alpha) / both


def _even_share(wi: Any, layers: Layers) -> Float:
    """Probability of the cosine lobe in the native sampler: half of what enters comes back."""
    reflectance = fresnel(wi.z, layers.eta)[0]
    return (1 - reflectance) / (1 + reflectance)


def _interpolated(table: Any, row: Any, mu: Float) -> Any:
    """Radiance at the cosine ``mu``: linear in its square root, constant below the first node."""
    at = dr.maximum(dr.sqrt(mu) * NODES - 1, 0)
    low = dr.minimum(dr.uint32_array_t(mu)(at), NODES - 2)
    first = row * NODES + low
    a, b = (dr.gather(type(table), table, first + k) for k in (0, 1))
    return dr.lerp(a, b, at - type(mu)(low))
