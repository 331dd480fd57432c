"""``effects: auto``: the smallest set of effects whose image is that of all, and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.core import registry
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.effects.offer import offer
from harness.effects.registry import EFFECTS
from harness.effects.variants import full, lit, name_of, replaced, without
from harness.rendering.meter import Meter
from harness.rendering.prepared import prepare
from harness.scenes.base import Scene, XmlScene
from harness.stats.difference import Difference, difference

RESOLUTION, BATCHES = 48, 8
SPP, MOST_SPP = 8, 128
"""Samples per pixel and batch; doubled up to the most while noise leaves a question open."""
DEPTHS = (2, 3, 4, 6, 8)
"""Bounces that are tried in place of all, fewest first."""
SEED = 20_000_000


@dataclass
class Choice:
    """What was called for in the end, and a sentence for every effect that could have been."""

    tolerance: float
    everything: tuple[str, ...]
    effects: tuple[str, ...]
    why: dict[str, str] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """To be stored beside the numbers that were taken with it."""
        return {
            "tolerance": self.tolerance,
            "everything": list(self.everything),
            "chosen": list(self.effects),
            "why": self.why,
        }


def resolve(
    scene: Scene | XmlScene, material: Material, notify: Callable[[str], None] = lambda _: None
) -> tuple[Scene | XmlScene, Choice]:
    """The scene with the effects that ``auto`` stands for, for this material.

    From all that the scene has and the material can give, effects are left out one after the
    other, the costliest first; one stays out if the image of what is left is still that of all
    within the tolerance: the upper end of the interval of the relative mean squared error
    (:mod:`harness.stats.difference`) is at most its square. One that noise leaves undecided
    stays in. Of bounces the fewest that do. Light sampling changes no image; it stays if it
    lowers (variance x rays), or if there are lights without extent.

    Everything is of fixed seeds and nothing is timed, so the choice is always the same.
    """
    tolerance = float(scene.effects[0].partition(":")[2])
    search = _Search(scene, material, _method(material), tolerance, notify)
    search.run()
    return replace(scene, effects=search.choice.effects), search.choice


def _method(material: Material) -> Method:
    """The material's own sampler, or the cosine."""
    native = registry.make("native")
    method = native if native.supports(material)[0] else registry.make("cosine")
    method.bind(material)
    return method


class _Search:
    def __init__(
        self,
        scene: Scene | XmlScene,
        material: Material,
        method: Method,
        tolerance: float,
        notify: Callable[[str], None],
    ):
        self.scene, self.material, self.method = scene, material, method
        self.tolerance, self.notify = tolerance, notify
        self.has = offer(scene, material)
        everything = full(self.has)
        self.choice = Choice(tolerance, everything, everything)
        self._images: dict[tuple[tuple[str, ...], int], NDArray] = {}

    def run(self) -> None:
        """Leave out what can be."""
        for text in sorted(self.choice.everything, key=_costliest_first):
            name = name_of(text)
            if name == "emitter-sampling":
                continue
            self._try(name)
        if "emitter-sampling" in self.choice.effects:
            self._try_emitter_sampling()

    def _try(self, name: str) -> None:
        choice, less = self.choice, without(self.choice.effects, name, self.has)
        if not lit(less):
            choice.why[name] = "kept: the only light"
            return
        self.notify(f"auto: without {name}")
        apart = self._apart(less)
        if self._within(apart):
            choice.effects = less
            choice.why[name] = f"left out: {self._said(apart)}"
        elif name == "indirect":
            self._fewest_bounces(apart)
        else:
            choice.why[name] = f"kept: without it {self._said(apart)}"

    def _fewest_bounces(self, direct: Difference) -> None:
        choice = self.choice
        for depth in DEPTHS:
            self.notify(f"auto: {depth} bounces")
            less = replaced(choice.effects, f"indirect: {depth}")
            apart = self._apart(less)
            if self._within(apart):
                choice.effects = less
                choice.why["indirect"] = (
                    f"{depth} bounces: {self._said(apart)}; with one {self._said(direct)}"
                )
                return
        choice.why["indirect"] = f"kept in full: with one bounce {self._said(direct)}"

    def _try_emitter_sampling(self) -> None:
        """By deterministic costs: rays, not seconds."""
        choice = self.choice
        if "point-lights" in choice.effects:
            choice.why["emitter-sampling"] = "kept: lights without extent are found by it alone"
            return
        less = without(choice.effects, "emitter-sampling", self.has)
        self.notify("auto: without emitter-sampling")
        gain = self._noise_times_rays(less) / self._noise_times_rays(choice.effects)
        words = f"(variance x rays) without it is {gain:.3g} times that with it"
        if gain > 1:
            choice.why["emitter-sampling"] = f"kept: {words}"
        else:
            choice.effects = less
            choice.why["emitter-sampling"] = f"left out: {words}"

    def _within(self, apart: Difference) -> bool:
        return apart.value.high <= self.tolerance**2

    def _said(self, apart: Difference) -> str:
        value, low, high = (np.sign(v) * np.sqrt(abs(v)) for v in apart.value)
        return (
            f"the image is {max(value, 0):.2%} off [{max(low, 0):.2%}, {high:.2%}],"
            f" {self.tolerance:.2%} tolerated"
        )

    def _apart(self, effects: tuple[str, ...]) -> Difference:
        """From the image of everything, with samples until noise leaves no question."""
        spp, limit = SPP, self.tolerance**2
        while True:
            images = self._render(effects, spp), self._render(self.choice.everything, spp)
            found = difference(*images)
            undecided = found.value.low <= limit < found.value.high
            if not undecided or spp >= MOST_SPP:
                return found
            spp *= 4

    def _render(self, effects: tuple[str, ...], spp: int) -> NDArray:
        """Independent renders [BATCHES, H, W, 3]; of the same seeds whatever the effects."""
        if (effects, spp) not in self._images:
            ready = self._prepare(effects)
            seeds = range(SEED + 1000 * spp, SEED + 1000 * spp + BATCHES)
            self._images[effects, spp] = np.stack([ready.render(spp, s).rgb for s in seeds])
        return self._images[effects, spp]

    def _noise_times_rays(self, effects: tuple[str, ...]) -> float:
        variance = self._prepare(effects).render(4 * SPP, SEED + 1).variance.mean()
        meter = Meter()
        self._prepare(effects, meter).render(2, SEED)
        rays = 2 * RESOLUTION**2 + meter.counts["rays"] + meter.counts["shadow-rays"]
        return float(variance) * rays

    def _prepare(self, effects: tuple[str, ...], meter: Meter | None = None) -> Any:
        scene = replace(self.scene, effects=effects)
        # Paths in any case: images of one bounce and of more then have their noise in common.
        return prepare(scene, self.material, self.method, RESOLUTION, meter=meter, paths=True)


_ORDER = ("media", "multiple-scattering", "indirect", "area-lights", "point-lights", "environment")


def _costliest_first(text: str) -> int:
    """What usually costs most; where two effects stand in for each other, the first goes."""
    name = name_of(text)
    others = [*_ORDER, *(n for n in EFFECTS if n not in _ORDER)]
    return others.index(name)
