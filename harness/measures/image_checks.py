"""Is a method right as a renderer uses it? White furnace, mean images, MIS on, off and misled."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.material import Material
from harness.core.record import Record
from harness.geometry.shapes import sphere_mesh
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.batches import LEAST, LEAST_SPP, Batches, render_batches
from harness.measures.images import reference, too_slow
from harness.rendering import misreported
from harness.rendering.misreported import MisreportedBSDF
from harness.rendering.prepared import Prepared, prepare
from harness.scenes.base import Camera, Scene, Sphere
from harness.stats.intervals import ratio_of_means
from harness.stats.ztest import Agreement, agreement, holm

CHECKS = ("furnace", "reference", "mis", "mis-reference", "tripled", "tilted")
"""Metrics of the comparisons, in the order of the tables."""
RATIOS = ("mis-variance", "tripled-variance", "tilted-variance")
BLOCK = 16
ROUNDING = 2.0**-18
"""Relative error of a mean that single precision explains: some thirty roundings in a row, or
rays lost at edges between facets (one in a million). It does not average out over pixels."""

# Flat facets: with smoothed normals a direction above the shading horizon may lie below the
# facet, and its light is lost (5e-5 of it). A convex body of flat ones loses none. The corners
# of the image see the sphere at a cosine of 0.06: no pixel holds any of the silhouette.
FURNACE = Scene(
    "furnace",
    ("environment",),
    (replace(sphere_mesh(Sphere()), normals=None),),
    1.0,
    Camera(origin=(0.0, 0.0, 4.0), target=(0.0, 0.0, 0.0), fov=20.6),
    "a faceted sphere in constant light of radiance one",
)


@dataclass(frozen=True)
class Image:
    """Mean luminance [H, W] and the variance of that mean."""

    mean: NDArray
    variance: NDArray


class ImageChecks(Measure):
    """Whether images by the method have the right mean, by BSDF samples alone and with MIS.

    Each comparison is that of :mod:`harness.stats.ztest` (blocks of pixels and the whole
    image). It gives ``CHECK``, the relative difference of the image averages with a 95 %
    interval, ``CHECK-z`` and ``CHECK-p``:

    - ``furnace``: in constant light of radiance one a pixel is the albedo, that is one for a
      white Lambertian surface, else the reference's pixel (a long render that the method
      takes no part in);
    - ``reference``: the trial's scene by BSDF samples alone, against the reference;
    - ``mis``: with light samples too, against without. Differs where p = 0 and f > 0;
    - ``mis-reference``: with light samples, against the reference. Differs where ``pdf`` is
      not the density of ``sample``, for the weights then do not add up to one;
    - ``tripled``, ``tilted``: MIS that is told a wrong density by the factor 3, or exp(2 x)
      with x of the local direction, against MIS that is told the right one: the mean stays,
      see :class:`~harness.rendering.misreported.MisreportedBSDF`.

    ``p`` is the least of the p-values after Holm's correction: below alpha for a right method
    with at most the chance alpha (up to what the test's own docstring says of heavy tails).

    ``mis-variance`` is the variance of one sample with MIS over that without,
    ``tripled-variance`` and ``tilted-variance`` that of misled MIS over that of MIS. Where
    neither image has noise above single precision's rounding there is no such record.
    """

    name = "image-checks"

    class Settings(BaseSettings):
        """``batches`` renders of ``spp`` samples per pixel for each of the five images.

        ``max_seconds`` each, for which a slow method takes fewer samples; one that would need
        more than ``patience`` seconds for the least of all images is not begun.
        """

        batches: Annotated[int, Field(ge=LEAST)] = 12
        spp: Annotated[int, Field(ge=LEAST_SPP)] = 64
        resolution: int = 48
        reference_spp: Annotated[int, Field(ge=LEAST_SPP)] = 4096
        max_seconds: float = 20.0
        patience: float = 3600.0

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        strategies = _strategies(job, settings.resolution)
        least = LEAST_SPP * LEAST * len(strategies)
        if reason := too_slow(job, settings.resolution, least, settings.patience):
            raise BudgetExceeded(reason)
        images = {
            name: render_batches(
                prepared(),
                job,
                batches=settings.batches,
                spp=settings.spp,
                max_seconds=settings.max_seconds,
                # No seed twice: the images are compared as independent.
                seed=1_000_000 * (job.seed + 1) + number * settings.batches,
                notify=notify,
                label=name,
            )
            for number, (name, prepared) in enumerate(strategies.items())
        }
        notify(f"{job.material.name}: reference images")
        compared = _compared(job, settings, {k: _image(b) for k, b in images.items()})
        records = []
        for name in CHECKS:
            mask = images["furnace" if name == "furnace" else "bsdf"].mask
            records += _records(name, compare(*compared[name], mask))
        p = [r.value for r in records if r.metric.endswith("-p")]
        records.append(Record("p", float(holm(p).min()), unit="1"))
        records += _ratios(images)
        records.append(Record("spp", float(min(b.spp for b in images.values())), unit="1"))
        arrays = {f"{name}_variance": b.errors for name, b in images.items()}
        for name, batches in images.items():
            arrays[f"{name}_mean"] = batches.mean.astype(np.float32)
            arrays[f"{name}_variance_of_mean"] = batches.scatter_of_mean.astype(np.float32)
        arrays["mask"] = images["bsdf"].mask
        arrays["furnace_mask"] = images["furnace"].mask
        return Outcome(records=records, arrays=arrays, images={k: b.rgb for k, b in images.items()})


def is_white(material: Material, generator: torch.Generator, device: str = "cpu") -> bool:
    """Whether the BSDF is 1 / pi wherever it was asked: Lambertian, of albedo exactly one."""
    condition = material.conditions(4096, generator, device)
    wo = square_to_disk(torch.rand(4096, 2, generator=generator)).to(condition.device)
    f = material.eval(condition, wo)
    return bool(((f * math.pi - 1).abs() < 1e-5).all())


def compare(image: Image, expected: Image, mask: NDArray[np.bool_]) -> Agreement:
    """``image`` against ``expected``, independent of it.

    Both may be free of noise, yet not of rounding: :data:`ROUNDING` enters as an error that a
    block's average has, so a pixel has ``BLOCK`` times as much.
    """
    rounding = (ROUNDING * BLOCK * expected.mean) ** 2
    variances = [image.variance, expected.variance + rounding]
    return agreement([image.mean, expected.mean], variances, mask, BLOCK)[0]


def _strategies(job: Job, resolution: int) -> dict[str, Callable[[], Prepared]]:
    """The five images of the method; each is built when its turn comes."""
    make = partial(prepare, material=job.material, method=job.method, resolution=resolution)
    misled = {
        f.__name__: partial(MisreportedBSDF, factor=f)
        for f in (misreported.tripled, misreported.tilted)
    }
    return {
        "furnace": partial(make, FURNACE),
        "bsdf": partial(make, job.scene),
        "mis": partial(make, job.scene, sampling="mis"),
        **{name: partial(make, job.scene, sampling="mis", bsdf=b) for name, b in misled.items()},
    }


def _compared(
    job: Job, settings: ImageChecks.Settings, images: dict[str, Image]
) -> dict[str, tuple[Image, Image]]:
    """Image and expected image of every check."""

    def long(scene: object) -> Image:
        at = replace(job, scene=scene)
        done = reference(at, settings.resolution, settings.reference_spp)
        return Image(done.mean, done.variance / done.spp)

    if is_white(job.material, job.generator, job.budget.device):
        ones = np.ones_like(images["furnace"].mean)
        furnace = Image(ones, 0 * ones)
    else:
        furnace = long(FURNACE)
    truth = long(job.scene)
    return {
        "furnace": (images["furnace"], furnace),
        "reference": (images["bsdf"], truth),
        "mis": (images["mis"], images["bsdf"]),
        "mis-reference": (images["mis"], truth),
        "tripled": (images["tripled"], images["mis"]),
        "tilted": (images["tilted"], images["mis"]),
    }


def _image(batches: Batches) -> Image:
    return Image(batches.mean, batches.scatter_of_mean)


def _records(name: str, found: Agreement) -> list[Record]:
    records = [
        Record(f"{name}-z", found.global_score, unit="1"),
        Record(f"{name}-p", found.p_value, unit="1"),
    ]
    # Relative to a black image nothing is a number; its p-value is there all the same.
    if math.isfinite(found.difference):
        half = 1.96 * found.difference_error
        low, high = found.difference - half, found.difference + half
        records.insert(0, Record(name, found.difference, low, high, "1"))
    return records


def _ratios(images: dict[str, Batches]) -> list[Record]:
    """Variance with MIS over that without, and of misled MIS over that of MIS."""
    pairs = zip(RATIOS, (("mis", "bsdf"), ("tripled", "mis"), ("tilted", "mis")), strict=True)
    records = []
    for metric, names in pairs:
        over, under = (images[n] for n in names)
        resolved = _resolved(over), _resolved(under)
        if all(resolved):
            records.append(Record(metric, *ratio_of_means(over.errors, under.errors), "1"))
        elif any(resolved):
            # One of them is exact.
            records.append(Record(metric, math.inf if resolved[0] else 0.0, unit="1"))
    return records


def _resolved(batches: Batches) -> bool:
    """Whether the variance stands out of the rounding of the moments it is the difference of."""
    power = float(np.square(batches.mean[batches.mask]).mean())
    return bool((batches.errors > ROUNDING * power).all())
