r"""A rough dielectric interface over a medium over a diffuse base (Guo et al. 2018).

Light is followed in optical depth alone, hence "position-free". All that happens below the
interface forgets the azimuth (the medium scatters isotropically, the base is Lambertian, and
no light comes back up without one of them), so a walk's state is the cosine ``mu`` (positive
upward), the optical depth below the interface, and the rgb weight.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import drjit as dr

from harness.columns.bridge import Columns, Float
from harness.materials.families import ggx
from harness.materials.families.dielectric import fresnel, masking, pass_through
from harness.materials.families.hashing import exponential, generator_at
from harness.materials.families.parameters import LAYERED
from harness.materials.families.walks import WalkFamily

KEPT = 4.0
"""A walk whose largest weight is below 1/KEPT ends or goes on with that weight."""


class Layers(NamedTuple):
    """The parameters of the rows; ``albedo`` of the medium is rgb, ``base`` is grey."""

    eta: Float
    alpha: Float
    thickness: Float
    albedo: Any
    base: Float

    @property
    def roughness(self) -> ggx.Roughness:
        """As the microfacets want it."""
        return ggx.Roughness(self.alpha, self.alpha)


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
        inner = _connected(wi, out, layers, self.generator(c, wo, seed), self.walks, inside)
        f = _reflected(wi, out, layers) + inner / (self.walks * layers.eta * layers.eta)
        return dr.select(inside, f, 0)

    def walk_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Any]:
        """See :meth:`WalkFamily.walk_columns`."""
        layers, wi = self._unpacked(c)
        rng = generator_at(u, 0)
        first = pass_through(wi, layers.roughness, layers.eta, u[0], u[1])
        reflects = u[2] < first.reflectance
        w = dr.select(reflects, first.mirrored, first.refracted)
        lost = (w.z > 0) != reflects
        weight = dr.select(lost, 0, masking(w.z, layers.alpha))
        cos, inner = _walk(w.z, weight, layers, rng, ~(reflects | lost))
        sin, turn = dr.sqrt(dr.maximum(1 - cos * cos, 0)), 2 * math.pi * rng.next_float32()
        sine, cosine = dr.sincos(turn)
        out = ggx.vector(sin * cosine, sin * sine, cos)
        # A mirror direction below the horizon is lost; any valid one will do for a zero.
        kept = reflects & ~lost
        x, y = ggx.on_disk(dr.select(kept, w, out))
        return x, y, dr.select(kept, weight, inner)

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


class Event(NamedTuple):
    """One meeting of a walk, and its state (see the module's docstring) after it.

    ``leaving`` is the cosine outside where the light has left through the interface, else zero.
    Where it has met the interface and is lost, the weight is zero.
    """

    mu: Float
    depth: Float
    weight: Any
    scattered: Any
    at_base: Any
    leaving: Float


def _event(mu: Float, depth: Float, weight: Any, layers: Layers, rng: Any) -> Event:
    """The next meeting; four random numbers."""
    to = depth - exponential(rng) * mu
    u1, u2, u3 = rng.next_float32(), rng.next_float32(), rng.next_float32()
    at_base = (mu < 0) & (to >= layers.thickness)
    at_top = (mu > 0) & (to <= 0)
    scattered = ~(at_base | at_top)
    # The interface, seen from below.
    sine = dr.sqrt(dr.maximum(1 - mu * mu, 0))
    below = ggx.vector(sine, dr.zeros(type(sine)), dr.abs(mu))
    passage = pass_through(below, layers.roughness, 1 / layers.eta, u1, u2)
    reflects = u3 < passage.reflectance
    z = dr.select(reflects, passage.mirrored.z, -passage.refracted.z)
    masked = dr.select(z > 0, masking(z, layers.alpha), 0)
    leaving = dr.select(at_top & ~reflects, z, 0)
    mu = dr.select(scattered, 1 - 2 * u1, dr.select(at_base, dr.sqrt(1 - u1), -z))
    depth = dr.select(scattered, to, dr.select(at_base, layers.thickness, 0))
    gain = dr.select(at_base, layers.base, masked)
    weight = weight * dr.select(scattered, layers.albedo, gain)
    return Event(mu, depth, weight, scattered, at_base, leaving)


def _survival(weight: Any) -> Float:
    """Probability to go on, one for weights above 1/KEPT."""
    return dr.minimum(KEPT * dr.max(weight), 1)


@dr.syntax
def _walk(mu: Float, weight: Float, layers: Layers, rng: Any, active: Any) -> tuple[Float, Any]:
    """From below the interface until it leaves: the cosine outside and the rgb weight.

    Weight zero, and any cosine, where light is absorbed or lost, or ``active`` was not set.
    """
    depth, weight = dr.zeros(type(mu)), type(layers.albedo)(weight)
    cos, out = dr.full(type(mu), 1), dr.zeros(type(layers.albedo))
    # A thickness of nan is none; the walk must end.
    going = active & (layers.thickness >= 0)
    while dr.hint(going, mode="symbolic", label="layered walk"):
        event = _event(mu, depth, weight, layers, rng)
        out = dr.select(going & (event.leaving > 0), event.weight, out)
        cos = dr.select(going & (event.leaving > 0), event.leaving, cos)
        q = _survival(event.weight)
        going &= (event.leaving <= 0) & (rng.next_float32() < q)
        mu, depth, weight = event.mu, event.depth, event.weight / q
    return cos, out


@dr.syntax
def _connected(wi: Any, wo: Any, layers: Layers, rng: Any, walks: int, inside: Any) -> Any:
    """Sum over ``walks`` walks of eta^2 f_T, one loop over the events of all (as the conductor's).

    Light that crosses the interface is not followed: the connections have counted it.
    """
    rough, eta = layers.roughness, layers.eta
    color = type(layers.albedo)
    going = inside & (layers.thickness >= 0)
    left = dr.full(dr.uint32_array_t(wo.z), walks, dr.width(wo.z))
    total = dr.zeros(color)
    mu, depth, weight = dr.zeros(type(wo.z)), dr.zeros(type(wo.z)), dr.zeros(color)
    mu_out, weight_out = dr.full(type(wo.z), 1), dr.zeros(type(wo.z))
    begin = dr.mask_t(wo.z)(True)
    while dr.hint(going, mode="symbolic", label="layered connections"):
        # A walk begins with its entry and the way out of wo, and goes on with an event.
        u = [rng.next_float32() for _ in range(4)]
        enter = pass_through(wi, rough, eta, u[0], u[1])
        leave = pass_through(wo, rough, eta, u[2], u[3])
        mu_out = dr.select(begin, dr.abs(leave.refracted.z), mu_out)
        weight_out = dr.select(begin, _transmitted(leave, layers), weight_out)
        mu = dr.select(begin, enter.refracted.z, mu)
        depth = dr.select(begin, 0, depth)
        weight = dr.select(begin, color(_transmitted(enter, layers)), weight)
        event = _event(mu, depth, weight, layers, rng)
        seen = dr.select(event.scattered, 1 / (4 * math.pi * mu_out), 1 / math.pi)
        seen *= weight_out * dr.exp(-event.depth / mu_out)
        met = going & (event.scattered | event.at_base) & (seen > 0)
        total += dr.select(met, event.weight * seen, 0)
        q = _survival(event.weight)
        begin = ~((event.leaving <= 0) & (rng.next_float32() < q))
        mu, depth, weight = event.mu, event.depth, event.weight / q
        left -= dr.select(begin, 1, 0)
        going &= left > 0
    return total


def _transmitted(passage: Any, layers: Layers) -> Float:
    """Weight of always taking the refracted ray."""
    through = (1 - passage.reflectance) * masking(passage.refracted.z, layers.alpha)
    return dr.select(passage.refracted.z < 0, through, 0)
