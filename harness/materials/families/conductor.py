r"""A rough conductor with all its bounces (Heitz et al. 2016).

Light that leaves one microfacet may meet another. In Smith's model of independent heights
that is a random walk: with :math:`l = \ln C_1(h) \le 0`, the logarithm of the height's
distribution function, a ray of direction w meets the surface after it has changed l by
:math:`E/\Lambda(w)`, E exponential of mean one; it falls for w below the horizon, rises
above it, and leaves where l would reach zero. (Their equations for heights, whose distribution
drops out.) At each meeting it turns by a visible normal of -w and is dimmed by its Fresnel
reflectance.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.materials.families import ggx
from harness.materials.families.hashing import exponential, generator_at
from harness.materials.families.parameters import GGX_CONDUCTOR
from harness.materials.families.walks import WalkFamily


class Conductor(WalkFamily):
    r"""GGX of roughness ``alpha_x``, ``alpha_y`` and Schlick's Fresnel factor of ``r0_*`` (rgb).

    :meth:`eval` is the first bounce in closed form,

    .. math:: f_1 = \frac{F D(h)}{2\,(\cos\theta_o\,a(\omega_i) + \cos\theta_i\,a(\omega_o))},

    (Smith's height-correlated masking; a as in :mod:`.ggx`), and the mean of ``walks`` random
    walks for the rest, each connected to ``wo`` from its second meeting on:

    .. math:: f_{2+} = E\Big[\sum_{k \ge 2} T_k\,\frac{F D(h_k)}{4\,\sigma(\omega_k)}\,
              \frac{e^{l_k \Lambda(\omega_o)}}{\cos\theta_o}\Big].

    Walks start at ``wi``; that f is reciprocal is a property of the model, which tests use.
    The effect ``multiple-scattering`` is :math:`f_{2+}`.

    ``native_*_columns`` draw the first bounce's visible normals, and with a probability of a
    third of the mean roughness a cosine lobe. That is Heitz et al.'s density for multiple
    importance sampling, normalised and drawn exactly; :meth:`walk_columns` is the walk itself.
    """

    family = "ggx-conductor"
    model = GGX_CONDUCTOR
    effects = frozenset({"multiple-scattering"})

    def eval_columns(self, c: Columns, wo: Columns, seed: int = 0) -> Any:
        """See :meth:`Family.eval_columns`."""
        alpha, r0, wi = self._unpacked(c)
        inside = wo[0] * wo[0] + wo[1] * wo[1] < 1
        out = ggx.above(dr.select(inside, wo[0], 0), dr.select(inside, wo[1], 0))
        f = _first_bounce(wi, out, alpha, r0)
        if "multiple-scattering" not in self.off:
            rng = self.generator(c, wo, seed)
            more = _further_bounces(wi, out, alpha, r0, rng, self.walks, inside)
            f += more / (self.walks * out.z)
        return dr.select(inside, f, 0)

    def walk_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Any]:
        """See :meth:`WalkFamily.walk_columns`."""
        alpha, r0, wi = self._unpacked(c)
        m = ggx.sample_visible(wi, alpha, u[0], u[1])
        w, weight = ggx.mirrored(wi, m), ggx.schlick(r0, dr.dot(wi, m))
        if "multiple-scattering" in self.off:
            # G2 / G1 of Smith's correlated masking.
            seen = 2 * ggx.projected_area(wi, alpha) * w.z / _both_ways(wi, w, alpha)
            weight = dr.select(w.z > 0, weight * seen, 0)
        else:
            rng = generator_at(u, 0)
            depth = exponential(rng) * ggx.inverse_smith(-wi, alpha)
            w, weight = _walk(w, depth, weight, alpha, r0, rng)
        return *ggx.on_disk(w, w.z > 0), weight

    def native_sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """Directions and density ``(x, y, pdf)`` per disk area; three uniforms."""
        alpha, _, wi = self._unpacked(c)
        x, y = ggx.sample_mixture(wi, alpha, _even_share(alpha), u)
        return x, y, self.native_pdf_columns(c, [x, y])

    def native_pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """Density per disk area of :meth:`native_sample_columns`."""
        alpha, _, wi = self._unpacked(c)
        return ggx.pdf_mixture(wi, alpha, _even_share(alpha), wo)

    def _unpacked(self, c: Columns) -> tuple[ggx.Roughness, Any, Any]:
        """Roughness, reflectance at normal incidence (rgb) and wi of the rows."""
        v = self.values(c)
        alpha = ggx.Roughness(v["alpha_x"], v["alpha_y"])
        return alpha, ggx.vector(v["r0_r"], v["r0_g"], v["r0_b"]), ggx.above(*c[-2:])


def _both_ways(wi: Any, wo: Any, alpha: ggx.Roughness) -> Float:
    """2 cos cos (1 + Lambda + Lambda) of the two directions."""
    return wo.z * ggx.stretched(wi, alpha) + wi.z * ggx.stretched(wo, alpha)


def _first_bounce(wi: Any, wo: Any, alpha: ggx.Roughness, r0: Any) -> Any:
    h = dr.normalize(wi + wo)
    lobe = ggx.ndf(h, alpha) / (2 * _both_ways(wi, wo, alpha))
    return ggx.schlick(r0, dr.dot(wi, h)) * lobe


def _even_share(alpha: ggx.Roughness) -> Float:
    """Probability of the cosine lobe in the native sampler."""
    return (alpha.x + alpha.y) / 6


@dr.syntax
def _walk(w: Any, depth: Float, weight: Any, alpha: ggx.Roughness, r0: Any, rng: Any) -> Any:
    """From the first bounce until the light leaves: its direction and weight.

    ``w`` and ``weight`` after that bounce; ``depth``, the l of the module's docstring, at it.
    """
    active = dr.mask_t(depth)(True)
    while dr.hint(active, mode="symbolic", label="conductor walk"):
        to = depth + exponential(rng) * ggx.inverse_smith(w, alpha)
        # Not "unless it leaves": a walk of nan goes nowhere and must end.
        active &= (w.z <= 0) | (to < 0)
        m = ggx.sample_visible(-w, alpha, rng.next_float32(), rng.next_float32())
        dimmed = weight * ggx.schlick(r0, dr.dot(-w, m))
        weight = dr.select(active, dimmed, weight)
        w = dr.select(active, ggx.mirrored(-w, m), w)
        depth = to
    return w, weight


@dr.syntax
def _further_bounces(
    wi: Any, wo: Any, alpha: ggx.Roughness, r0: Any, rng: Any, walks: int, active: Any
) -> Any:
    """Sum over ``walks`` walks of f_2+ cos(theta_o): each connected to ``wo`` at every meeting.

    One loop over the meetings of all walks of a row: a row that has finished one begins the
    next, and does not wait for its neighbours.
    """
    leaving = ggx.smith(wo, alpha)
    left = dr.full(dr.uint32_array_t(leaving), walks, dr.width(leaving))
    total, weight = dr.zeros(type(wo)), dr.full(type(wo), 1)
    w, depth = type(wo)(-wi), dr.zeros(type(leaving))
    # A copy, for the loop writes to it.
    active, again = dr.mask_t(leaving)(active), dr.mask_t(leaving)(False)
    while dr.hint(active, mode="symbolic", label="conductor connections"):
        to = depth + exponential(rng) * ggx.inverse_smith(w, alpha)
        met = active & ((w.z <= 0) | (to < 0))
        h = dr.normalize(wo - w)
        facing = ggx.ndf(h, alpha) / (4 * ggx.projected_area(-w, alpha)) * dr.exp(to * leaving)
        joined = weight * ggx.schlick(r0, dr.dot(wo, h)) * facing
        total += dr.select(met & again & (facing > 0), joined, 0)
        m = ggx.sample_visible(-w, alpha, rng.next_float32(), rng.next_float32())
        weight = dr.select(met, weight * ggx.schlick(r0, dr.dot(-w, m)), 1)
        w = dr.select(met, ggx.mirrored(-w, m), -wi)
        depth = dr.select(met, to, 0)
        again = met
        left -= dr.select(active & ~met, 1, 0)
        active &= left > 0
    return total
