"""Pictures of a sampler in the scenes of the harness."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from harness.api.sampler import Sampler
from harness.api.subjects import ready, scene
from harness.core.protocol.errors import InputError

if TYPE_CHECKING:
    from harness.rendering.passes import Pass


def render(
    sampler: Sampler,
    where: Any = "uniform-sphere",
    resolution: int = 128,
    spp: int = 64,
    seed: int = 0,
) -> Pass:
    """Render a sampler in a scene: a name (``harness list scenes``) or an entry of a suite.

    ``resolution`` pixels across and ``spp`` samples in each. Gives ``rgb`` [H, W, 3], the mean
    radiance, ``mean`` [H, W], its luminance, ``variance`` [H, W], the unbiased variance of one
    sample of that (nan for one sample a pixel), and ``seconds``.

    Raises:
        InputError: a scene that is refused.
        Unsupported: the material reads more of the scene than a condition has.
    """
    if not isinstance(sampler, Sampler):
        raise InputError(f"render: expected what harness.fit gives, got {sampler!r}")
    for key, value in (("resolution", resolution), ("spp", spp)):
        if not (isinstance(value, int) and value > 0):
            raise InputError(f"render: {key}: expected a whole number above 0, got {value!r}")
    ready(sampler.device)
    from harness.effects.offer import offer
    from harness.effects.registry import is_auto
    from harness.effects.variants import full
    from harness.rendering.prepared import prepare

    placed = scene(where)
    if is_auto(placed.effects):
        # All that there is: what can be left out is a suite's question.
        placed = replace(placed, effects=full(offer(placed, sampler.material)))
    return prepare(placed, sampler.material, sampler.method, resolution).render(spp, seed)
