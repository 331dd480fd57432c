"""Pictures to look at: a large render of equal time by each method, and a reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.deadline_render import CHUNKS, DeadlineRender, render_to_deadlines
from harness.measures.images import checked, reference, too_slow
from harness.rendering.passes import Pass
from harness.rendering.prepared import Prepared, prepare


class Pictures(Measure):
    """What a person sees of a method: numbers come from other measures, of smaller renders.

    Every method renders for ``deadline`` seconds, in chunks between those of the others. The
    reference is a render of ``reference_spp`` samples by Mitsuba's own BSDF with light sampling, or
    by cosine sampling where the material or scene has no such render. It is stored with the
    baseline's picture.

    ``relative-mse`` of a picture: the variance of one sample over its samples and the mean squared
    luminance of the reference, over the pixels that show the material.
    """

    name = "pictures"
    timed = True

    class Settings(BaseSettings):
        """A picture has ``picture_size`` pixels a side.

        A method that would need more than ``patience`` seconds for two samples of each is not
        begun.
        """

        picture_size: int = 256
        deadline: float = 0.4
        reference_spp: int = 256
        patience: float = 60.0

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        settings = self.Settings(**jobs[0].settings)
        slow = [too_slow(job, settings.picture_size, 2, settings.patience) for job in jobs]
        entrants = [
            _Entrant(job, prepare(job.scene, job.material, job.method, settings.picture_size))
            for job, reason in zip(jobs, slow, strict=True)
            if not reason
        ]
        renders = []
        for entrant in entrants:
            notify(f"{entrant.job.method.name}: warm-up")
            seed = 800_000 + 7919 * entrant.job.seed
            known = entrant.warm_up(seed, settings.deadline / CHUNKS)
            renders.append(DeadlineRender(entrant.render, known, settings.deadline, seed + 10))
        notify(f"{settings.deadline:g} s each, {len(entrants)} methods")
        render_to_deadlines(renders)
        notify(f"{jobs[0].material.name}: reference")
        truth = reference(jobs[0], settings.picture_size, settings.reference_spp)
        found = (e.outcome(r, truth) for e, r in zip(entrants, renders, strict=True))
        return [Outcome("timeout", reason) if reason else next(found) for reason in slow]


@dataclass
class _Entrant:
    """A method, and sums over its renders of luminance [H, W] and its square, each by samples."""

    job: Job
    prepared: Prepared
    renders: int = 0
    spp: int = 0
    total: NDArray | float = 0.0
    squares: NDArray | float = 0.0

    def render(self, spp: int, seed: int) -> Pass:
        rendered = checked(self.prepared.render(spp, seed), self.job)
        self.renders, self.spp = self.renders + 1, self.spp + spp
        self.total = self.total + spp * rendered.mean
        self.squares = self.squares + spp * np.square(rendered.mean)
        return rendered

    def warm_up(self, seed: int, chunk: float) -> float:
        """Compile; then seconds a sample, from a render of about half of ``chunk`` seconds if one
        of a single sample does not take as long. Seeds up to ``seed`` + 9 are used."""
        self.render(1, seed)
        count, seconds = 1, self.render(1, seed + 1).seconds
        if seconds < 0.5 * chunk:
            # Where the count is no power of two, Mitsuba divides by it: a kernel of its own.
            self.render(3, seed + 2)
        for k in range(3, 10):
            if seconds >= 0.5 * chunk:
                break
            count *= 2
            seconds = self.render(count, seed + k).seconds
        return seconds / count

    @property
    def variance(self) -> float:
        """Of one sample, mean over the pixels that count: from how the renders' means differ.

        Those of the warm-up count, so that there are two at least.
        """
        between = (self.squares - np.square(self.total) / self.spp) / (self.renders - 1)
        return float(between[self.prepared.mask].mean())

    def outcome(self, render: DeadlineRender, truth: Pass) -> Outcome:
        mask = self.prepared.mask
        arrays: dict[str, NDArray] = {
            "chunk_spp": np.array([spp for spp, _ in render.chunks], np.int32),
            "chunk_seconds": np.array([seconds for _, seconds in render.chunks]),
            "variance": np.array(self.variance),
            "squared_mean": np.array(np.square(truth.mean[mask]).mean()),
            "mask": mask,
        }
        images = {"picture": render.image}
        return Outcome(
            arrays=arrays, images=images | ({"reference": truth.rgb} if self.job.baseline else {})
        )
