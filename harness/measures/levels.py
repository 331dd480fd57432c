"""How close a neural material comes to the surface it stands for, across levels of detail."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from skimage.metrics import structural_similarity

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import Unsupported
from harness.materials.neural.material import NeuralMaterial
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.flip import exposures, flip
from harness.microgeometry import descriptions, preview, queries
from harness.nets.mlp import count_parameters

METRICS = ("mse", "flip", "ssim")


class Levels(Measure):
    r"""MSE, FLIP and SSIM of a plane against path tracing; NeuMIP's Tables 2-4 and Figures 10-11.

    At level l a pixel is :math:`2^l` texels wide and its footprint's deviation half of that.
    ``views`` pictures of ``size``^2 pixels a level, each with a camera and a light of its own
    (the first at NeuMIP's 45 degrees). FLIP and SSIM are means over them; MSE is their median,
    for a view near the mirror direction has more of it than all others together. With 95 %
    intervals. The truth is traced twice with ``samples`` paths a pixel; the noise of its mean, a
    quarter of the mean squared difference of the two, is taken off the MSE, which is therefore
    unbiased in each view and may be a little below zero. The method plays no part.
    """

    name = "levels"
    needs_scene = False

    class Settings(BaseSettings):
        """``levels`` of detail, from the finest on; see the class."""

        levels: int = 6
        views: int = 6
        size: int = 64
        samples: int = 32

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        material = job.material
        surface = surface_of(material)
        found: dict[str, list[np.ndarray]] = {metric: [] for metric in METRICS}
        images: dict[str, np.ndarray] = {}
        draws = torch.rand(settings.views, 4, generator=job.generator)
        wi = 0.9 * square_to_disk(draws[:, :2])
        wo = 0.9 * square_to_disk(draws[:, 2:])
        wi[0] = torch.tensor([0.0, -math.sqrt(0.5)])
        for level in range(settings.levels):
            notify(f"level {level}")
            values = []
            for view in range(settings.views):
                pair = self._pair(material, surface, wi[view], wo[view], level, view, settings)
                truth, noise, ours = pair
                values.append(compared(ours, truth, noise))
                if view == 0:
                    images[f"truth-{level}"], images[f"neural-{level}"] = truth, ours
            for metric, column in zip(METRICS, zip(*values, strict=True), strict=True):
                found[metric].append(np.array(column))
        arrays = {metric: single(np.stack(columns)) for metric, columns in found.items()}
        return Outcome(arrays={**arrays, **sizes(material)}, images=images)

    @staticmethod
    def _pair(
        material: NeuralMaterial,
        surface: Any,
        wi: torch.Tensor,
        wo: torch.Tensor,
        level: int,
        view: int,
        settings: Settings,
    ) -> tuple[np.ndarray, float, np.ndarray]:
        """The truth's picture [S, S, 3], the variance of its noise, and the network's."""
        resolution = material.network.architecture.resolution
        tiles = settings.size * 2.0**level / resolution
        shots = preview.plane_shots(
            settings.size, tuple(wi.tolist()), tuple(wo.tolist()), tiles=tiles
        )

        def traced(seed: int) -> np.ndarray:
            answer = lambda u, k, i, o: queries.truth(  # noqa: E731
                surface, u, k, i, o, settings.samples, seed
            )
            return preview.develop(shots, answer).cpu().numpy()

        def neural(u: Any, kernel: Any, i: Any, o: Any) -> torch.Tensor:
            detail = torch.log2(2 * resolution * kernel)
            return material.eval(material.condition_at(u, i, detail), o)

        first, second = traced(2 * view), traced(2 * view + 1)
        noise = float(np.square(first - second).mean()) / 4
        return (first + second) / 2, noise, preview.develop(shots, neural).cpu().numpy()


def compared(
    image: np.ndarray, truth: np.ndarray, noise: float = 0.0
) -> tuple[float, float, float]:
    """MSE less ``noise``, FLIP, and SSIM of log(1 + x), of ``image`` against ``truth``."""
    mse = float(np.square(image - truth).mean()) - noise
    a, b = (np.log1p(np.maximum(x, 0)) for x in (image, truth))
    # A flat picture has no range of its own, and is as like itself with any other.
    span = float(b.max() - b.min()) or 1.0
    ssim = structural_similarity(a, b, channel_axis=-1, data_range=span)
    return mse, flip(image, truth, exposures(truth))[0], float(ssim)


def sizes(material: NeuralMaterial) -> dict[str, np.ndarray]:
    """Fitted numbers of the networks and of the textures (NeuMIP, Table 4)."""
    net = material.network
    networks = count_parameters_of(net.decoder)
    texels = net.texture.numel()
    if net.offset is not None:
        networks += count_parameters_of(net.offset.network)
        texels += net.offset.texture.numel()
    channels = net.texture.shape[1] + (net.offset.texture.shape[1] if net.offset else 0)
    return {
        "network_parameters": np.array(networks),
        "texture_numbers": np.array(texels),
        "texture_channels": np.array(channels),
    }


def count_parameters_of(module: torch.nn.Module) -> int:
    """All numbers of a module, trained any more or not."""
    return count_parameters(module) or sum(p.numel() for p in module.parameters())


def surface_of(material: Any) -> Any:
    """The microgeometry that a neural material was trained on.

    Raises:
        Unsupported: it is no neural material, or its surface is not known or not the same
            any more.
    """
    if not isinstance(material, NeuralMaterial) or not material.record:
        raise Unsupported(f"material '{material.name}' has no record of a microgeometry")
    record = material.record
    name = record["name"]
    if name not in descriptions.names():
        raise Unsupported(f"material '{material.name}': there is no description '{name}' any more")
    surface = descriptions.load(name)
    if surface.identity()["description"] != record["description"]["description"]:
        raise Unsupported(f"material '{material.name}': description '{name}' has changed since")
    return surface
