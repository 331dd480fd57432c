"""Walks below a rough dielectric interface, as Guo et al. (2018) follow them.

All that happens there forgets the azimuth (the medium scatters isotropically, the base is
Lambertian, and no light comes back up without one of them), so a walk's state is the cosine
``mu`` (positive upward), the optical depth below the interface, and the rgb weight.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import drjit as dr

from harness.core.columns.bridge import Float
from harness.materials.families import ggx
from harness.materials.families.dielectric import Passage, masking, pass_through
from harness.materials.families.hashing import exponential

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


class Event(NamedTuple):
    """One meeting of a walk, and its state after it.

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
def walk(mu: Float, weight: Float, layers: Layers, rng: Any, active: Any) -> tuple[Float, Any]:
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


class WayOut:
    """How a connection goes on from the interface to ``wo``: through a facet that it sees."""

    def __init__(self, layers: Layers, wo: Any):
        self.layers, self.wo = layers, wo

    def __call__(self, u1: Float, u2: Float) -> tuple[Float, Float]:
        """The cosine inside and the weight; two uniforms."""
        leave = pass_through(self.wo, self.layers.roughness, self.layers.eta, u1, u2)
        return dr.abs(leave.refracted.z), _transmitted(leave, self.layers)


class Cosine:
    """A connection to a given cosine inside."""

    def __init__(self, mu: Float):
        self.mu = mu

    def __call__(self, u1: Float, u2: Float) -> tuple[Float, Float]:
        """That cosine, and the weight one; no use for uniforms."""
        return self.mu, 1


@dr.syntax
def connected(wi: Any, way_out: Any, layers: Layers, rng: Any, walks: int, inside: Any) -> Any:
    """Sum over ``walks`` walks of eta^2 f_T, one loop over the events of all (as the conductor's).

    ``way_out(u1, u2)`` gives the cosine that a walk's events are connected to, and a weight.
    Light that crosses the interface is not followed: the connections have counted it.
    """
    rough, eta = layers.roughness, layers.eta
    color = type(layers.albedo)
    going = inside & (layers.thickness >= 0)
    array, n = type(wi.z), dr.width(inside)
    left = dr.full(dr.uint32_array_t(array), walks, n)
    total = dr.zeros(color)
    mu, depth, weight = dr.zeros(array), dr.zeros(array), dr.zeros(color)
    mu_out, weight_out = dr.full(array, 1), dr.zeros(array)
    begin = dr.mask_t(array)(True)
    while dr.hint(going, mode="symbolic", label="layered connections"):
        # A walk begins with its entry and the way out of wo, and goes on with an event.
        u = [rng.next_float32() for _ in range(4)]
        enter = pass_through(wi, rough, eta, u[0], u[1])
        cosine, transmitted = way_out(u[2], u[3])
        mu_out = dr.select(begin, cosine, mu_out)
        weight_out = dr.select(begin, transmitted, weight_out)
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


def _transmitted(passage: Passage, layers: Layers) -> Float:
    """Weight of always taking the refracted ray."""
    through = (1 - passage.reflectance) * masking(passage.refracted.z, layers.alpha)
    return dr.select(passage.refracted.z < 0, through, 0)
