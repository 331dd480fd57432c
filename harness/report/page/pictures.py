"""Renders and their references with all their values, error maps, and the squares that tell most.

Values are half floats, as they are stored. Where those of a whole suite are more than a page can
carry, they are 8 or 7 bits of a logarithm in lossless WebP instead, or in lossy WebP where that is
too much, and the page says how far these are off.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.analysis.combine import Estimate
from harness.analysis.results import Results
from harness.report.figures.rendered import LUMINANCE, exposure
from harness.report.formats.short import short
from harness.report.page.names import Names
from harness.report.page.plain import number, packed
from harness.report.series.flip import flip
from harness.report.series.shots import (
    Shot,
    Square,
    scenes,
    shots,
    square_error,
    telling_squares,
    truth,
)

BUDGET = 5_000_000
"""Characters of all images of a page."""
_COSTS = {0: 2.2, 255: 0.64, 127: 0.5}
"""Characters that a value of noise takes, about: as a half float (0), or as one of so many steps of
a logarithm."""
_FLIP_LIMIT = 6e6
"""Pixels of which FLIP's maps are made: it takes a second for a million."""
_STOPS = 20.0
"""Powers of two that 8 bits of a logarithm span, below the brightest value."""
_QUALITY = 80
"""Of lossy WebP."""


def pictures(results: Results) -> dict[str, Any]:
    """``groups`` by scene and material, ``pixels`` the values that they name by place."""
    names = Names(results)
    found = [
        (scene, material, made)
        for scene in scenes(results)
        for material in results.materials
        if (made := shots(results, material, scene))
    ]
    images = [shot.image for *_, made in found for shot in made if shot.image is not None]
    total = sum(image.size for image in images) + sum(
        next(s.image for s in made if s.image is not None).size for *_, made in found
    )
    fits = [steps for steps, cost in _COSTS.items() if cost * total <= BUDGET]
    store = _Pixels(fits[0] if fits else None)
    with_flip = sum(image.shape[0] * image.shape[1] for image in images) <= _FLIP_LIMIT
    groups = [
        _group(results, names, store, scene, material, made, with_flip)
        for scene, material, made in found
    ]
    return {
        "groups": groups,
        "pixels": store.kept,
        "exact": store.exact,
        "off": number(store.worst, 2),
        "flip": with_flip,
    }


def _group(
    results: Results,
    names: Names,
    store: _Pixels,
    scene: str,
    material: str,
    made: list[Shot],
    with_flip: bool,
) -> dict[str, Any]:
    right = truth(results, material, scene, made)
    renders = {s.method.label: s.image for s in made if s.image is not None}
    first = next(iter(renders.values())) if right is None else right
    mask = next((shot.mask for shot in made if shot.mask is not None), None)
    squares = telling_squares(list(renders.values()), first, mask) if right is not None else []
    return {
        "material": names.materials.index(material),
        "scene": names.scenes.index(scene) if scene in names.scenes else -1,
        "width": first.shape[1],
        "height": first.shape[0],
        "exposure": number(exposure(first)),
        "reference": None if right is None else store.keep(right),
        # The squares' error over this and the image's own mean square: a dim pixel divides less.
        "floor": number(0.01 * float(np.square(first @ LUMINANCE).mean())),
        "shots": [_shot(shot, names, store, right if with_flip else None) for shot in made],
        "squares": [_square(one, renders, right, first) for one in squares],
    }


def _shot(shot: Shot, names: Names, store: _Pixels, right: NDArray | None) -> dict[str, Any]:
    made: dict[str, Any] = {"method": names.methods.index(shot.method.label)}
    if shot.trial:
        made["trial"] = names.trials[shot.trial]
    made["spp"] = shot.spp if isinstance(shot.spp, str) else f"{shot.spp.value:.0f} spp"
    error = shot.relative_mse
    made["error"] = short(error.value) if isinstance(error, Estimate) else "†"
    if shot.image is None:
        return made | {"why": shot.why}
    made["image"] = store.keep(shot.image)
    if right is not None:
        mean, shown = flip(shot.image, right)
        made["flip"] = store.keep_bytes(np.round(255 * np.clip(shown, 0, 1)).astype(np.uint8))
        made["flipMean"] = f"{mean:.3f}"
    return made


def _square(
    at: Square, renders: dict[str, NDArray], right: NDArray, first: NDArray
) -> dict[str, Any]:
    """A square with the error of the best and worst method in it, and where it is in words."""
    errors = {label: square_error(image, right, at) for label, image in renders.items()}
    ranked = sorted((e, label) for label, e in errors.items() if math.isfinite(e))
    said = f"{_where(at, first)}"
    if ranked:
        (low, best), (high, worst) = ranked[0], ranked[-1]
        said += f": relMSE {short(low)} with {best}, {short(high)} with {worst}"
    return {"x": at.column, "y": at.row, "side": at.side, "said": said}


def _where(at: Square, image: NDArray) -> str:
    """``upper left, 2.1 times as bright as the image``."""
    height, width = image.shape[:2]
    row = ("upper", "middle", "lower")[min(2, int(3 * (at.row + at.side / 2) / height))]
    column = ("left", "middle", "right")[min(2, int(3 * (at.column + at.side / 2) / width))]
    place = "centre" if row == column == "middle" else f"{row} {column}"
    light = image @ LUMINANCE
    here = light[at.row : at.row + at.side, at.column : at.column + at.side].mean()
    bright = float(here / light.mean()) if light.mean() > 0 else 1.0
    return f"{place}, {bright:.1f} times as bright as the whole"


class _Pixels:
    """Images as text, each once; ``worst`` is the largest relative error of one that is lossy.

    ``steps`` of a logarithm are kept, all digits with 0, and with None what lossy WebP keeps.
    """

    def __init__(self, steps: int | None):
        self.kept: list[dict[str, Any]] = []
        self.steps = steps
        self.worst = 0.0

    @property
    def exact(self) -> bool:
        return self.steps == 0

    def keep(self, image: NDArray) -> int:
        """The place of an image [H, W, 3]."""
        if self.exact:
            # Above its largest number a half float has only infinity.
            half = np.minimum(image, 65504.0).astype(np.float16)
            self.kept.append(packed(np.moveaxis(half, -1, 0)))
        else:
            self.kept.append(self._lossy(image))
        return len(self.kept) - 1

    def keep_bytes(self, image: NDArray[np.uint8]) -> int:
        """The place of an image [H, W] of bytes."""
        if self.exact:
            self.kept.append(packed(image))
        else:
            self.kept.append({"shape": list(image.shape), "webp": _webp(image, lossless=False)})
        return len(self.kept) - 1

    def _lossy(self, image: NDArray) -> dict[str, Any]:
        from PIL import Image

        steps = self.steps or 255
        top = math.log2(max(float(np.max(image[np.isfinite(image)], initial=0.0)), 1e-30))
        light = np.maximum(image, 2.0 ** (top - _STOPS))
        share = (np.log2(light) - top + _STOPS) / _STOPS
        text = _webp(
            np.round(steps * np.clip(share, 0, 1)).astype(np.uint8), self.steps is not None
        )
        back = np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB"), float)
        found = 2.0 ** (back / steps * _STOPS + top - _STOPS)
        scale = float(np.sqrt(np.square(image).mean()))
        if scale > 0:
            off = float(np.sqrt(np.square(found - image).mean())) / scale
            self.worst = max(self.worst, off)
        return {
            "shape": list(image.shape), "webp": text, "top": top, "stops": _STOPS, "steps": steps,
        }  # fmt: skip


def _webp(image: NDArray, lossless: bool) -> str:
    from PIL import Image

    how = {"lossless": True, "quality": 20, "method": 1} if lossless else {"quality": _QUALITY}
    out = io.BytesIO()
    Image.fromarray(image).convert("RGB").save(out, "WEBP", **({"method": 2} | how))
    return base64.b64encode(out.getvalue()).decode("ascii")


def sizes(found: dict[str, Any]) -> Iterator[str]:
    """Resolutions of a page's images, in words, each once."""
    yield from dict.fromkeys(f"{g['width']} × {g['height']}" for g in found["groups"])
