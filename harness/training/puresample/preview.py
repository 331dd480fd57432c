"""Pictures of a material learned from walks beside the walks themselves."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from harness.core.pictures import MARK
from harness.core.protocol.errors import InputError
from harness.materials.neural.textures import lookup
from harness.materials.puresample import storage
from harness.materials.puresample.network import CHANNELS, PureSample
from harness.microgeometry.preview import srgb
from harness.microgeometry.walks import preview as walks
from harness.microgeometry.walks.surface import WalkedSurface
from harness.training.puresample import sources

_ROWS = 1 << 13


def write(
    file: Path,
    description: str | None,
    out: Path,
    cells: int = 64,
    count: int = 1 << 20,
    device: str = "cpu",
) -> Path:
    """Draw what leaves from three directions, by walks and by the network of ``file``; the PNG.

    Each picture is log(1 + f) over the disk of wo: above, f as the mean over cells of ``count``
    particles a channel; below, the network's, as bright. At the left the surface from above, and
    a material's latent texture where it has one: its three main directions as colours.
    """
    network, record = storage.load(file), storage.record(file)
    name = str(record.get("name", file.stem))
    if description is None and not {"name", "description"} <= set(record):
        raise InputError(f"{file}: has no record of its surface; give --description")
    source = sources.load(description) if description else sources.of_record(record)
    above = [walks.exits(source, wi, cells, count, 1, device).numpy() for wi in walks.DIRECTIONS]
    below = [learned(network, wi, cells).numpy() for wi in walks.DIRECTIONS]
    left = [None, None]
    if isinstance(source, WalkedSurface):
        left[0] = srgb(walks.plan(source, 4 * cells, device).numpy())
    if network.texture is not None:
        left[1] = latent(network, 4 * cells)
    _figure(above, below, left, name).savefig(out, dpi=100, metadata=MARK)
    return out


@torch.no_grad()
def learned(network: PureSample, wi: tuple[float, float], cells: int) -> Tensor:
    """f of the network at the middle of each cell of the disk's square: [cells, cells, 3].

    In the mean over 16 places where the material varies.
    """
    at = (torch.arange(cells) + 0.5) / cells * 2 - 1
    y, x = torch.meshgrid(at.flip(0), at, indexing="ij")
    wo = torch.stack([x, y], -1).view(-1, 2)
    inside = torch.nonzero(wo.square().sum(1) < 1)[:, 0]
    places = torch.full((1, 2), 0.5)
    if network.texture is not None:
        middle = (torch.arange(4) + 0.5) / 4
        places = torch.cartesian_prod(middle, middle)
    image = torch.zeros(cells * cells, CHANNELS)
    for place in places:
        feature = network.features(place[None])
        for rows in inside.split(_ROWS):
            n = len(rows)
            features, from_ = feature.expand(n, -1), torch.tensor(wi).expand(n, 2)
            albedo = network.albedo(features, from_)
            for k in range(CHANNELS):
                of = torch.full((n,), k)
                density = network.log_density(features, of, from_, wo[rows]).exp()
                image[rows, k] += density * albedo[:, k] / len(places)
    return image.view(cells, cells, CHANNELS)


@torch.no_grad()
def latent(network: PureSample, size: int) -> np.ndarray:
    """The texture [size, size, 3] by its three directions of most variance, each over its range."""
    table, side = network.texture.detach(), network.architecture.resolution
    centred = table - table.mean(0)
    _, _, main = torch.linalg.svd(centred.double().T @ centred.double())
    colours = centred.double() @ main[: min(3, len(main))].T
    low, high = colours.quantile(0.01, 0), colours.quantile(0.99, 0)
    # A direction without variance has no range; it stays grey.
    span = torch.where(high > low, high - low, math.inf)
    colours = ((colours - low) / span).clamp(0, 1).float()
    at = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(at.flip(0), at, indexing="ij")
    found = lookup(colours, side, torch.stack([u, v], -1).view(-1, 2)).view(size, size, -1)
    missing = 3 - found.shape[-1]
    return torch.cat([found, found.new_zeros(size, size, missing)], -1).numpy()


def _figure(above: list[np.ndarray], below: list[np.ndarray], left: list[Any], name: str) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3 * (len(above) + 1), 6.5), layout="constrained")
    axes = figure.subplots(2, len(above) + 1)
    for line, images, label, first in zip(
        axes, (above, below), ("walks", "learned"), left, strict=True
    ):
        if first is None:
            line[0].axis("off")
        else:
            line[0].imshow(first)
            line[0].set_title("from above" if label == "walks" else "latent texture", fontsize=10)
        for axis, image, truth, wi in zip(line[1:], images, above, walks.DIRECTIONS, strict=True):
            axis.imshow(_display(image, truth))
            title = f"wi = ({wi[0]:g}, {wi[1]:g})"
            axis.set_title(title if label == "walks" else "", fontsize=10)
        line[1].set_ylabel(f"{name}, {label}", fontsize=11)
        for axis in line:
            axis.set_xticks([])
            axis.set_yticks([])
    return figure


def _display(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """log(1 + f) in sRGB over the truth's brightest percentile; white off the disk."""
    at = (np.arange(len(image)) + 0.5) / len(image) * 2 - 1
    off = at[:, None] ** 2 + at**2 > 1
    peak = np.percentile(np.log1p(truth)[~off], 99.5)
    found = srgb(np.log1p(image) / peak)
    found[off] = 1
    return found
