"""What each effect of a scene costs, what it changes, and whether the scene needs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from harness.core.protocol.errors import BudgetExceeded
from harness.core.record import Record
from harness.effects.offer import offer
from harness.effects.variants import explicit, lit, name_of, with_one_more, without
from harness.measures.base import Job, Measure, Outcome
from harness.measures.flip import exposures, flip
from harness.measures.images import checked, too_slow
from harness.measures.renders import RenderSettings
from harness.measures.timing import Contender, Timings, interleave, settle
from harness.rendering.meter import COUNTS, Meter
from harness.rendering.passes import Pass
from harness.rendering.prepared import Prepared, prepare
from harness.stats.difference import difference
from harness.stats.intervals import median_interval, speed_up

FULL = "as called for"
NEEDED, NEGLIGIBLE, MISSING, SPARE = "needed", "negligible", "missing", "not needed"
VERDICTS = (NEGLIGIBLE, NEEDED, MISSING, SPARE)
"""By the number that is recorded. The last two are of effects that the scene does not call for."""


class Effects(Measure):
    """Each effect of a scene: seconds that it adds, how the image changes without it, a verdict.

    The scene is rendered as it is, once without each effect that it calls for (a material's own
    effects and colour among them), and once with each effect more that it and the material
    could give. All take turns, one render of each a round, of the same samples and from the same
    random numbers; a render is both a timing and one of the images that the differences are
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
        """See :class:`Measure`. Methods are not compared here; each has its turn."""
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
        return _outcome(job, shots, timings, settings)


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
        self.counts = {name: n / rays for name, n in meter.counts.items()}

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


def _outcome(job: Job, shots: list[_Shot], timings: Timings, settings: Effects.Settings) -> Outcome:
    whole = shots[0]
    halves = whole.half(0), whole.half(1)
    parameters = exposures(whole.images.mean(0))
    power = float(np.square(whole.images.mean(0)).mean())
    # A half's variance is twice that of the whole, and there are two of them.
    noise = 4 * float(whole.images.var(0, ddof=1).mean()) / len(whole.passes) / power
    records = [
        Record("seconds-per-spp", *timings.median(0), "s"),
        Record("noise", noise, unit="1"),
        Record("flip-noise", flip(*halves, parameters)[0], unit="1"),
        Record("tolerance", settings.tolerance, unit="1"),
    ]
    images = {"full": whole.images.mean(0)}
    arrays = {"seconds": timings.seconds(0), "variance": whole.variance}
    called = {name_of(text) for text in whole.effects}
    if len(lights := [n for n in called if not lit([t for t in whole.effects if t != n])]):
        records += _only_light(lights[0], whole, parameters)
    for index, shot in enumerate(shots[1:], 1):
        found, shown = _compare(shot, whole, timings, index, parameters, settings.tolerance, called)
        records += found
        images[shot.name], images[f"{shot.name}.flip"] = shot.images.mean(0), shown
        arrays[f"{shot.name}.seconds"] = timings.seconds(index)
        arrays[f"{shot.name}.variance"] = shot.variance
    return Outcome(records=records, arrays=arrays, images=images)


def _only_light(name: str, whole: _Shot, parameters: dict) -> list[Record]:
    """Without it the image is black, and nothing is rendered to find that out."""
    black = np.zeros_like(whole.passes[0].rgb)
    return [
        Record(f"{name}.relmse", 1.0, 1.0, 1.0, "1"),
        Record(f"{name}.flip", flip(black, whole.images.mean(0), parameters)[0], unit="1"),
        Record(f"{name}.verdict", float(VERDICTS.index(NEEDED)), unit="1"),
    ]


def _compare(
    shot: _Shot,
    whole: _Shot,
    timings: Timings,
    index: int,
    parameters: dict,
    tolerance: float,
    called: set[str],
) -> tuple[list[Record], NDArray]:
    """The records of one effect, and FLIP's map as a picture [H, W, 3]."""
    name, there = shot.name, shot.name in called
    sign = 1 if there else -1
    saved = sign * (timings.rival_seconds(index) - timings.seconds(index))
    images = (
        (shot.paired_images, whole.paired_images)
        if name == "indirect"
        else (shot.images, whole.images)
    )
    apart = difference(*images)
    mean, shown = flip(*(stack.mean(0) for stack in images), parameters)
    matters = apart.value.value > tolerance**2 and apart.value.low > 0
    unclear = apart.value.low < tolerance**2 < apart.value.high
    records = [
        Record(f"{name}.seconds", *median_interval(saved), "s"),
        Record(f"{name}.relmse", *apart.value, "1"),
        Record(f"{name}.flip", mean, unit="1"),
    ]
    if name == "emitter-sampling":
        off, on = (shot, whole) if there else (whole, shot)
        times = timings.seconds(index), timings.rival_seconds(index)
        gain = speed_up(off.variance, on.variance, *(times if there else times[::-1]))
        records.append(Record(f"{name}.gain", *gain, "1"))
        if not matters:
            matters, unclear = gain.value > 1, gain.low < 1 < gain.high
    verdict = (NEEDED if matters else NEGLIGIBLE) if there else MISSING if matters else SPARE
    records += [
        Record(f"{name}.verdict", float(VERDICTS.index(verdict)), unit="1"),
        Record(f"{name}.unclear", float(unclear), unit="1"),
    ]
    kinds = dict.fromkeys([*COUNTS, *shot.counts, *whole.counts])
    for kind in kinds:
        more = sign * (whole.counts.get(kind, 0.0) - shot.counts.get(kind, 0.0))
        records.append(Record(f"{name}.{kind}", more, unit="1/sample"))
    return records, np.repeat(shown[..., None], 3, -1)
