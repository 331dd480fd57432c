"""A sheet of a material learned from walks beside a path tracer on its microgeometry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from harness.core.protocol.errors import Unsupported
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.images import checked
from harness.measures.timing import round_order
from harness.measures.walks import size_bytes, source_of
from harness.microgeometry.walks.meshes import parts
from harness.microgeometry.walks.surface import WalkedSurface
from harness.rendering.passes import Pass
from harness.rendering.prepared import Prepared, prepare
from harness.rendering.tiled import prepare_tiled
from harness.scenes.base import Scene
from harness.stats.blocks import Blocks

BLOCKS = 6
"""Blocks along a picture in which it is compared at large."""
_LEAST = 2
"""Samples of a pixel that tell a variance."""


class Patches(Measure):
    """Time, noise and difference of the material's renders and of its microgeometry's own.

    In ``rounds``, each in an order drawn for it, Mitsuba's path tracer renders triangles of the
    surface laid on the scene's sheets, and the material is rendered on the sheets by the method,
    ``spp`` samples a pixel. All ``truth_spp`` samples of the truth are divided among the rounds.
    Luminance in those pixels that show the material alone.

    ``noise`` is the variance of one sample of a pixel over the mean square of the truth.
    ``same-noise-time-ratio`` is how many times as long the path tracer takes to the same noise, the
    samples being independent: the ratio of seconds times variances. ``macro-error`` is the mean
    squared difference of means over blocks, 6 x 6 in a picture, over the truth's mean square, the
    noise of both taken off: what no number of samples mends.
    """

    name = "patches"
    timed = True

    class Settings(BaseSettings):
        """See the class."""

        resolution: int = 96
        rounds: Annotated[int, Field(ge=2)] = 6
        spp: Annotated[int, Field(ge=_LEAST)] = 16
        truth_spp: Annotated[int, Field(ge=2 * _LEAST)] = 1024

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        job = jobs[0]
        settings = self.Settings(**job.settings)
        surface = source_of(job.material)
        if not isinstance(surface, WalkedSurface) or not isinstance(job.scene, Scene):
            raise Unsupported("needs a described surface, and one of the scenes with sheets")
        notify(f"{job.scene.name}: triangles of {surface.name}")
        truth = prepare_tiled(job.scene, surface, settings.resolution)
        bytes_of_tile = sum(part.size_bytes for part in parts(surface))
        each = max(_LEAST, settings.truth_spp // settings.rounds)
        # The first render of each compiles.
        truth.render(each, 1)
        ready = []
        for one in jobs:
            prepared = prepare(one.scene, one.material, one.method, settings.resolution)
            prepared.render(settings.spp, 1)
            ready.append(prepared)
        taken: list[list[Pass]] = [[] for _ in range(len(jobs) + 1)]
        for number in range(settings.rounds):
            notify(f"{job.scene.name}: round {number + 1} of {settings.rounds}")
            seed = 1000 * (job.seed + 1) + number
            entrants = [(truth, each), *((p, settings.spp) for p in ready)]
            for k in round_order(len(entrants), number):
                prepared, spp = entrants[k]
                # No two entrants share random numbers.
                rendered = prepared.render(spp, seed + 10**6 * int(k))
                taken[k].append(checked(rendered, job))
        known = _Mean.of(taken[0])
        return [
            _outcome(known, _Mean.of(found), prepared, bytes_of_tile, size_bytes(one.material))
            for one, prepared, found in zip(jobs, ready, taken[1:], strict=True)
        ]


class _Mean:
    """The mean of renders: ``rgb`` [H, W, 3], ``luminance`` and its ``variance`` [H, W] of one
    sample, ``spp`` in all and ``seconds`` a sample in each render."""

    def __init__(self, rgb: NDArray, luminance: NDArray, variance: NDArray, passes: list[Pass]):
        self.rgb, self.luminance, self.variance = rgb, luminance, variance
        self.spp = sum(one.spp for one in passes)
        self.seconds = np.array([one.seconds / one.spp for one in passes])

    @classmethod
    def of(cls, passes: list[Pass]) -> _Mean:
        """Of renders of equally many samples."""
        parts = ([getattr(one, key) for one in passes] for key in ("rgb", "mean", "variance"))
        return cls(*(np.mean(part, 0) for part in parts), passes)


def _outcome(
    truth: _Mean, found: _Mean, prepared: Prepared, truth_bytes: int, own_bytes: int
) -> Outcome:
    mask = prepared.mask
    size = max(1, mask.shape[1] // BLOCKS)
    known, own = (Blocks.of(x.luminance, x.variance / x.spp, mask, size) for x in (truth, found))
    return Outcome(
        arrays={
            "seconds": single(found.seconds),
            "truth_seconds": single(truth.seconds),
            "variance": single(found.variance[mask].mean()),
            "truth_variance": single(truth.variance[mask].mean()),
            "power": single((truth.luminance**2 - truth.variance / truth.spp)[mask].mean()),
            "pixels": known.pixels.astype(np.uint32),
            "blocks": known.packed(),
            "learned_blocks": own.packed(),
            "size_bytes": np.array(own_bytes),
            "truth_size_bytes": np.array(truth_bytes),
        },
        images={"truth": truth.rgb, "learned": found.rgb},
    )
