"""What a ray of a walk meets."""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr


class Hit(NamedTuple):
    """The first thing that a ray meets, over Dr.Jit arrays.

    ``si`` has the place and the shading frame and is a Mitsuba surface interaction; ``valid``,
    whether there is one; ``second``, where the second micro-BSDF holds, None if there is but one;
    ``tint`` multiplies what is reflected; ``given_up``, whether the search took too many steps.
    """

    si: Any
    valid: Any
    second: Any
    tint: Any
    given_up: Any


def sampled(
    bsdfs: list[Any],
    shares: list[Any],
    context: Any,
    hit: Hit,
    first: Any,
    second: Any,
    active: Any,
) -> tuple[Any, Any]:
    """A direction in the hit's frame, and its weight, rgb, by the micro-BSDF that holds there.

    ``shares`` (rgb) multiply the weights of each of the one or two ``bsdfs``. What goes into the
    surface has no weight.
    """
    taken, weight = bsdfs[0].sample(context, hit.si, first, second, active)
    wo, weight = taken.wo, weight * shares[0]
    if hit.second is not None:
        other, other_weight = bsdfs[1].sample(context, hit.si, first, second, active)
        wo = dr.select(hit.second, other.wo, wo)
        weight = dr.select(hit.second, other_weight * shares[1], weight)
    weight = dr.select(wo.z > 0, weight * hit.tint, 0)
    return wo, weight
