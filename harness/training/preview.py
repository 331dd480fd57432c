"""Pictures of a neural material beside the path-traced truth: sphere, plane, slices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from harness.core.pictures import MARK
from harness.core.protocol.errors import InputError
from harness.materials.neural import files, storage, textures
from harness.materials.neural.network import NeuralMBTF
from harness.microgeometry import descriptions
from harness.microgeometry import preview as shots
from harness.microgeometry.queries import truth

SLICES = (((0.3, 0.3), (0.0, 0.0)), ((0.62, 0.41), (0.5, 0.2)), ((0.15, 0.8), (-0.75, 0.35)))
"""Places and ``wi`` of the slices over wo."""

OBLIQUE = (0.0, -0.7)


def write(
    file: Path,
    description: str | None = None,
    out: Path | None = None,
    size: int = 256,
    spp: int = 32,
    device: str = "cpu",
) -> Path:
    """Draw the material of ``file`` and what it was trained on; returns the PNG's path.

    Upper row the truth, lower the network: a sphere under a studio light, a plane from above
    and from the side, and three slices over wo at fixed places and directions: log(1 + f), as
    bright as the truth's brightest allows.

    Raises:
        InputError: nothing says which microgeometry the material stands for.
    """
    if file.suffix == ".safetensors":
        network, record = storage.load(file), storage.record(file)
    else:
        network, record = files.make(file.stem, file, {}).network, {}
    name = str(record.get("name", file.stem))
    if description is None and not record:
        raise InputError(f"{file}: has no record of its microgeometry; give --description")
    surface = descriptions.load(description or name)
    network.to(device)
    rows = [
        draw(surface, answer, size, spp, device)
        for answer in _answers(surface, network, spp, device)
    ]
    out = out or Path(f"{name}-preview.png")
    _figure(rows, name).savefig(out, dpi=100, metadata=MARK)
    return out


def draw(surface: Any, answer: Any, size: int, spp: int, device: str) -> list[Tensor]:
    """The six pictures [H, W, 3] by one answer; slices are log(1 + f), and white off the disk."""
    found = [
        shots.develop(shots.sphere_shots(size, spp=8, dome=1.0), answer(1)),
        shots.develop(shots.plane_shots(size), answer(spp)),
        shots.develop(shots.plane_shots(size, wi=OBLIQUE), answer(spp)),
    ]
    side = size // 4
    at = (torch.arange(side) + 0.5) / side * 2 - 1
    y, x = torch.meshgrid(at.flip(0), at, indexing="ij")
    wo = torch.stack([x, y], -1).view(-1, 2)
    inside = wo.square().sum(1) < 0.999
    for place, wi in SLICES:
        n = int(inside.sum())
        u = torch.tensor(place).expand(n, 2).contiguous()
        kernel = torch.full((n,), 0.5 / 128)
        f = answer(spp)(u, kernel, torch.tensor(wi).expand(n, 2).contiguous(), wo[inside])
        image = torch.full((side * side, 3), torch.inf)  # brighter than any peak: white
        image[inside] = f.cpu().log1p()
        found.append(image.view(side, side, 3))
    return found


def _answers(surface: Any, network: NeuralMBTF, spp: int, device: str) -> list[Any]:
    """The truth's and the network's answers, by the number of paths per query."""

    def traced(samples: int) -> Any:
        return lambda u, kernel, wi, wo: truth(
            surface, u, kernel, wi, wo, samples, 0, device=device
        ).cpu()

    @torch.no_grad()
    def neural(u: Tensor, kernel: Tensor, wi: Tensor, wo: Tensor) -> Tensor:
        a = network.architecture
        parts = []
        for rows in torch.arange(len(u)).split(1 << 17):
            v, k, i, o = (x[rows].to(device) for x in (u, kernel, wi, wo))
            level = textures.level_of(k, a.resolution) if a.pyramid else None
            parts.append(network.reflectance(network.features(v, i, level), i, o).cpu())
        return torch.cat(parts)

    return [traced, lambda _samples: neural]


def _figure(rows: list[list[Tensor]], name: str) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3 * len(rows[0]), 6.5), layout="constrained")
    axes = figure.subplots(2, len(rows[0]))
    titles = ["sphere", "plane", "plane, from the side"] + [
        f"slice over wo, wi = ({wi[0]:g}, {wi[1]:g})" for _, wi in SLICES
    ]
    slices = (image.numpy() for image in rows[0][3:])
    peaks = [None] * 3 + [float(np.percentile(s[np.isfinite(s)], 99.5)) for s in slices]
    for line, images, label in zip(axes, rows, ("path-traced", "neural"), strict=True):
        for axis, image, peak, title in zip(line, images, peaks, titles, strict=True):
            axis.imshow(_display(image.numpy(), peak))
            axis.set_xticks([])
            axis.set_yticks([])
            axis.set_title(title if label == "path-traced" else "", fontsize=10)
        line[0].set_ylabel(f"{name}, {label}", fontsize=11)
    return figure


def _display(image: np.ndarray, peak: float | None) -> np.ndarray:
    """For a screen, in sRGB: over ``peak``, where that is known; else highlights rolled off."""
    return shots.srgb(image / (1 + 0.15 * image) if peak is None else image / peak)
