"""Is a method right as a renderer uses it? White furnace, mean images, MIS on, off and misled."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.material import Material
from harness.geometry.primitives import Sphere
from harness.geometry.shapes import sphere_mesh
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.batches import LEAST, LEAST_SPP, render_batches
from harness.measures.compact import single
from harness.measures.images import reference, too_slow
from harness.rendering import misreported
from harness.rendering.misreported import MisreportedBSDF
from harness.rendering.prepared import Prepared, prepare
from harness.scenes.base import Camera, Scene
from harness.stats.blocks import Blocks

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


class ImageChecks(Measure):
    """Whether images by the method have the right mean, by BSDF samples alone and with MIS.

    Each comparison is that of :mod:`harness.stats.ztest` (blocks of pixels and the whole
    image), of moments of blocks, which are what is stored. It gives ``CHECK``, the relative
    difference of the image averages with a 95 % interval, ``CHECK-z`` and ``CHECK-p``:

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
        blocks = {
            name: Blocks.of(done.mean, done.scatter_of_mean, done.mask)
            for name, done in images.items()
        }
        masks = images["furnace"].mask, images["bsdf"].mask
        blocks["furnace_reference"], blocks["reference"] = _references(job, settings, *masks)
        arrays = {f"{name}_blocks": one.packed() for name, one in blocks.items()}
        arrays |= {f"{name}_variance": single(done.errors) for name, done in images.items()}
        for name, one in (("pixels", blocks["bsdf"]), ("furnace_pixels", blocks["furnace"])):
            arrays[name] = one.pixels.astype(np.uint16)
        arrays["spp"] = np.array(min(done.spp for done in images.values()))
        return Outcome(arrays=arrays, images={k: done.rgb for k, done in images.items()})


def is_white(material: Material, generator: torch.Generator, device: str = "cpu") -> bool:
    """Whether the BSDF is 1 / pi wherever it was asked: Lambertian, of albedo exactly one."""
    condition = material.conditions(4096, generator, device)
    wo = square_to_disk(torch.rand(4096, 2, generator=generator)).to(condition.device)
    f = material.eval(condition, wo)
    return bool(((f * math.pi - 1).abs() < 1e-5).all())


def _strategies(job: Job, resolution: int) -> dict[str, Callable[[], Prepared]]:
    """The five images of the method; each is built when it is rendered."""
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


def _references(
    job: Job,
    settings: ImageChecks.Settings,
    furnace_mask: NDArray[np.bool_],
    mask: NDArray[np.bool_],
) -> tuple[Blocks, Blocks]:
    """What the furnace and the trial's scene should show."""

    def long(scene: object, chosen: NDArray[np.bool_]) -> Blocks:
        at = replace(job, scene=scene)
        done = reference(at, settings.resolution, settings.reference_spp)
        return Blocks.of(done.mean, done.variance / done.spp, chosen)

    if is_white(job.material, job.generator, job.budget.device):
        ones = np.ones(furnace_mask.shape)
        return Blocks.of(ones, 0 * ones, furnace_mask), long(job.scene, mask)
    return long(FURNACE, furnace_mask), long(job.scene, mask)
