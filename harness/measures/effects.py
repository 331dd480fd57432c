"""What each effect of a scene costs, what it changes, and whether the scene needs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from harness.core.protocol.errors import BudgetExceeded
from harness.effects.offer import offer
from harness.effects.variants import explicit, lit, name_of, with_one_more, without
from harness.measures.base import Job, Measure, Outcome
from harness.measures.compact import single
from harness.measures.flip import exposures, flip
from harness.measures.images import checked, too_slow
from harness.measures.renders import RenderSettings
from harness.measures.timing import Contender, Timings, interleave, settle
from harness.rendering.meter import COUNTS, Meter
from harness.rendering.passes import Pass
from harness.rendering.prepared import Prepared, prepare
from harness.stats.difference import power, products

FULL = "as called for"


class Effects(Measure):
    """Each effect of a scene: seconds that it adds, how the image changes without it, a verdict.

    The scene is rendered as it is, once without each effect that it calls for (a material's own
    effects and colour among them), and once with each effect more that it and the material
    could give. All are rendered once in each round, of the same samples and from the same random
    numbers; a render is both a timing and one of the images that the differences are
    estimated from. What two images have of the same noise does not tell them apart. For
    ``indirect`` the image of direct light is rendered once more, untimed, by a path tracer, whose
    random numbers are those of more bounces.

    For EFFECT: ``EFFECT.seconds`` per sample per pixel that it adds, of paired rounds;
    ``EFFECT.relmse``, the squared difference of the two expected images over the mean square of
    the scene's own, free of noise (:mod:`harness.stats.difference`), over all pixels and
    channels; ``EFFECT.flip`` of the two images. Beside them ``noise`` and ``flip-noise`` are
    those of two images of the scene itself that have half of the renders each.
    ``EFFECT.COUNT`` is how many more rays, evaluations and so on it takes for each sample of a
    pixel (:class:`~harness.rendering.meter.Meter`).

    ``EFFECT.verdict``: *needed* (1) where the root of relMSE is above ``tolerance``, beyond
    noise, else *negligible* (0); of one that the scene does not call for, *missing* (2) or *not
    needed* (3). Light sampling changes noise alone: its verdict is whether ``gain`` is above
    one, (variance x seconds) without it over that with it, unless lights without extent need
    it. ``EFFECT.unclear`` is 1 where the interval reaches to both sides.
    """

    name = "effects"
    timed = True

    class Settings(RenderSettings):
        """``rounds`` of each variant, ``slice_seconds`` each; see :class:`RenderSettings`.

        Never fewer than ``spp`` samples per pixel: a small image takes as long for a few as for
        one.
        ``tolerance`` is of the root of the relative mean squared error.
        """

        rounds: Annotated[int, Field(ge=6)] = 12
        max_rounds: int | None = 0
        spp: Annotated[int, Field(ge=2)] = 16
        tolerance: Annotated[float, Field(gt=0)] = 0.01

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`. Methods are not compared here: one after the other."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        variants = variants_of(job)
        least = settings.spp * settings.rounds * len(variants)
        if reason := too_slow(job, settings.resolution, least, settings.patience):
            raise BudgetExceeded(reason)
        shots = []
        for name, effects in variants.items():
            notify(f"{name}: preparing")
            spp = shots[0].spp if shots else 0
            direct = "indirect" not in map(name_of, effects)
            paired = direct and "indirect" in variants and name in (FULL, "indirect")
            shots.append(_Shot(job, name, effects, settings, spp, paired=paired))
        timings = interleave([shot.contender() for shot in shots], settings, notify)
        for shot in shots:
            notify(f"{shot.name}: counting")
            shot.count()
        return _outcome(shots, timings)


def variants_of(job: Job) -> dict[str, tuple[str, ...]]:
    """The scene's own effects under :data:`FULL`, and by name without or with one more each.

    The only light of a scene has no variant: without it there is nothing to render.
    """
    has = offer(job.scene, job.material)
    own = explicit(job.scene.effects, has)
    less = {name_of(text): without(own, name_of(text), has) for text in _named(own)}
    more = with_one_more(own, has)
    found = {name: effects for name, effects in {**less, **more}.items() if lit(effects)}
    return {FULL: own, **found}


def _named(effects: tuple[str, ...]) -> list[str]:
    """Those that can be left out."""
    return [t for t in effects if name_of(t) != "material" and t != "colour: luminance"]


@dataclass
class _Shot:
    """The scene with one list of effects, and its renders, one a round."""

    job: Job
    name: str
    effects: tuple[str, ...]
    settings: Effects.Settings
    spp: int
    passes: list[Pass] = field(default_factory=list)
    counts: dict[str, float] = field(default_factory=dict)
    paired: bool = False
    """Whether its direct light has to be rendered by a path tracer too, to be compared."""
    pairs: list[NDArray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.prepared = self._prepare()
        self.paths = self._prepare(paths=True) if self.paired else self.prepared
        seeds = iter(range(77, 10**6))

        def once() -> float:
            return checked(self.prepared.render(self.spp, next(seeds)), self.job).seconds

        if self.spp == 0:
            # As many as fill a slice; those of the scene itself are all others' too.
            self.spp = self.settings.spp
            seconds = settle(once, self.settings) / self.spp
            self.spp = max(self.spp, int(self.settings.slice_seconds / seconds))
        settle(once, self.settings)

    def _prepare(self, **how: Any) -> Prepared:
        job = self.job
        scene = replace(job.scene, effects=self.effects)
        return prepare(scene, job.material, job.method, self.settings.resolution, **how)

    def contender(self) -> Contender:
        """Seconds per sample per pixel, beside the scene as it is."""
        return Contender(self.name, self._once, self.spp, None if self.name == FULL else 0)

    def _once(self, number: int) -> float:
        # The same of all variants in a round, and no other round's.
        seed = 1_000_003 * (self.job.seed + 1) + number
        self.passes.append(checked(self.prepared.render(self.spp, seed), self.job))
        if self.paired:
            self.pairs.append(checked(self.paths.render(self.spp, seed), self.job).rgb)
        return self.passes[-1].seconds

    def count(self) -> None:
        """What is run for one sample of a pixel, on average over the image."""
        meter = Meter()
        done = self._prepare(meter=meter).render(2, 5)
        rays = done.mean.size * done.spp
        found = {name: n / rays for name, n in meter.counts.items()}
        self.counts = {**dict.fromkeys(COUNTS, 0.0), **found}

    @property
    def images(self) -> NDArray:
        """[rounds, H, W, 3]."""
        return np.stack([p.rgb for p in self.passes])

    @property
    def paired_images(self) -> NDArray:
        """The same [rounds, H, W, 3], from the random numbers of a path tracer."""
        return np.stack(self.pairs) if self.paired else self.images

    def half(self, odd: int) -> NDArray:
        """Mean [H, W, 3] of every second render."""
        return np.mean([p.rgb for p in self.passes[odd::2]], 0)

    @property
    def variance(self) -> NDArray:
        """Of one sample, averaged over the image, by each round."""
        return np.array([p.variance.mean() for p in self.passes])


def _outcome(shots: list[_Shot], timings: Timings) -> Outcome:
    whole = shots[0]
    full = whole.images.mean(0)
    parameters = exposures(full)
    called = [name_of(text) for text in whole.effects]
    images = {"full": full}
    arrays = {
        "seconds": single(timings.seconds(0)),
        "variance": single(whole.variance),
        "products": products(whole.images),
        "flip-noise": np.array(flip(whole.half(0), whole.half(1), parameters)[0]),
    }
    light = next((n for n in called if not lit([t for t in whole.effects if t != n])), "")
    if light:
        arrays[f"{light}.flip"] = np.array(flip(np.zeros_like(full), full, parameters)[0])
    for index, shot in enumerate(shots[1:], 1):
        found, shown = _compared(shot, whole, timings, index, parameters)
        arrays |= {f"{shot.name}.{what}": values for what, values in found.items()}
        images[shot.name], images[f"{shot.name}.flip"] = shot.images.mean(0), shown
    about = {
        "called": called,
        "only_light": light,
        "compared": [shot.name for shot in shots[1:]],
        "counts": {"full": whole.counts, **{shot.name: shot.counts for shot in shots[1:]}},
    }
    return Outcome(arrays=arrays, images=images, documents={"effects": about})


def _compared(
    shot: _Shot, whole: _Shot, timings: Timings, index: int, parameters: dict
) -> tuple[dict[str, NDArray], NDArray]:
    """Raw arrays of one effect, and FLIP's map as a picture [H, W, 3].

    ``products`` [rounds, rounds] are all that :func:`~harness.stats.difference.difference_of` needs
    of the images without and with it.
    """
    paired = shot.name == "indirect"
    mine, full = (one.paired_images if paired else one.images for one in (shot, whole))
    mean, shown = flip(mine.mean(0), full.mean(0), parameters)
    arrays = {
        "seconds": single(timings.seconds(index)),
        "full_seconds": single(timings.rival_seconds(index)),
        "variance": single(shot.variance),
        "products": products(mine - full),
        "power": np.array(power(full)),
        "flip": np.array(mean),
    }
    return arrays, np.repeat(shown[..., None], 3, -1)
