"""A measured BTF as a source of queries: interpolated between the directions measured."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay, QhullError
from torch import Tensor

from harness.core.protocol.errors import InputError
from harness.core.streams import generator
from harness.microgeometry.btf_file import Btf, read

ROWS = 1 << 14
"""Look-ups decoded at a time, which bounds the memory."""


class Directions:
    """Barycentric interpolation between measured directions, on the projected disk.

    Beyond the outermost ones (the Bonn dome ends at 75 degrees) a direction counts as the one
    of its azimuth on their hull: nothing is extrapolated.
    """

    def __init__(self, directions: NDArray[np.float32], what: str):
        points = directions[:, :2].astype(float)
        try:
            self._mesh = Delaunay(points)
            edges = ConvexHull(points).equations
        except (QhullError, ValueError):  # the latter for numbers that are none
            raise InputError(f"{what}: expected directions that span the disk") from None
        if (edges[:, 2] >= 0).any():
            raise InputError(f"{what}: expected directions all around the normal")
        self._normal, self._reach = edges[:, :2], -edges[:, 2]

    def weights(self, w: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """``(index [N, 3], weight [N, 3])`` of the measured directions around ``w`` [N, 2]."""
        share = (w @ self._normal.T) / self._reach  # above 1: beyond that edge
        # A hair inside the hull, where rounding cannot lose the triangle.
        inside = w / np.maximum(1, share.max(1) * (1 + 1e-9))[:, None]
        triangle = self._mesh.find_simplex(inside, tol=1e-7)
        frame = self._mesh.transform[triangle]
        two = np.einsum("nij,nj->ni", frame[:, :2], inside - frame[:, 2])
        weight = np.concatenate([two, 1 - two.sum(1, keepdims=True)], 1)
        return self._mesh.simplices[triangle].astype(np.int64), weight.astype(np.float32)


class MeasuredSurface:
    """Answers queries from a Bonn ``.btf`` file.

    Values are taken as the reflectance per steradian, divided by the light's cosine where the
    file says that it is in them. The picture repeats; its width is the width of the tile, v runs
    with its rows. There are no paths here, so ``depth`` and ``light`` have no meaning.
    """

    def __init__(self, path: Path | str):
        path = Path(path)
        self.name = path.stem
        self.btf: Btf = read(path)
        self._digest = hashlib.sha256(path.read_bytes()).hexdigest()
        try:
            self._views = Directions(self.btf.views, "views")
            self._lights = Directions(self.btf.lights, "lights")
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        if self.btf.has_cosine and (self.btf.lights[:, 2] <= 0).any():
            raise InputError(f"{path}: a light at the horizon; its cosine cannot be divided out")

    @property
    def resolution(self) -> int:
        """Texels along the longer side."""
        return max(self.btf.width, self.btf.height)

    def identity(self) -> dict[str, Any]:
        """The file's content."""
        return {"type": "btf", "sha256": self._digest}

    def reflectance(
        self,
        u: Tensor,
        kernel: Tensor,
        wi: Tensor,
        wo: Tensor,
        samples: int,
        seed: int,
        depth: int = 1,
        device: str = "cpu",
        light: float = 0.0,
    ) -> Tensor:
        """See :func:`harness.microgeometry.queries.truth`: [N, 3] on ``device``."""
        random = generator(seed)
        result = np.empty((len(u), 3), np.float32)
        rows = max(1, ROWS // samples)
        for first in range(0, len(u), rows):
            part = slice(first, first + rows)
            result[part] = self._mean(
                *(x[part].cpu().numpy() for x in (u, kernel, wi, wo)), samples, random
            )
        return torch.from_numpy(result).to(device)

    def _mean(
        self,
        u: NDArray[Any],
        kernel: NDArray[Any],
        wi: NDArray[Any],
        wo: NDArray[Any],
        samples: int,
        generator: torch.Generator,
    ) -> NDArray[np.float32]:
        random = torch.rand(len(u), samples, 2, generator=generator).numpy()
        radius = np.sqrt(-2 * np.log1p(-random[..., 0])) * kernel[:, None]
        turn = 2 * math.pi * random[..., 1]
        place = u[:, None] + radius[..., None] * np.stack([np.cos(turn), np.sin(turn)], -1)
        texel, share = self.texels(place.reshape(-1, 2))
        view, view_weight = self._views.weights(wi)
        lamp, lamp_weight = self._lights.weights(wo)
        total = np.zeros((len(u), samples, 3), np.float32)
        for i in range(3):
            for j in range(3):
                weight = (view_weight[:, i] * lamp_weight[:, j])[:, None, None]
                index = lamp[:, j] + len(self.btf.lights) * view[:, i]
                if self.btf.has_cosine:
                    weight = weight / self.btf.lights[lamp[:, j], 2][:, None, None]
                index = np.repeat(index, samples)
                for k in range(4):
                    value = self._decode(index, texel[:, k]) * share[:, k, None]
                    total += weight * value.reshape(len(u), samples, 3)
        return total.mean(1)

    def texels(self, place: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """``(index [N, 4], weight [N, 4])`` of the texels around uv [N, 2], wrapping around."""
        size = np.array([self.btf.width, self.btf.height])
        at = place * size[0] - 0.5  # square texels: the width of the picture is the tile's
        corner = np.floor(at).astype(np.int64)
        part = (at - corner).astype(np.float32)
        index, weight = [], []
        for dy in (0, 1):
            for dx in (0, 1):
                cell = (corner + (dx, dy)) % size
                index.append(cell[:, 0] + self.btf.width * cell[:, 1])
                x = part[:, 0] if dx else 1 - part[:, 0]
                y = part[:, 1] if dy else 1 - part[:, 1]
                weight.append(x * y)
        return np.stack(index, 1), np.stack(weight, 1)

    def _decode(self, direction: NDArray[np.int64], texel: NDArray[np.int64]) -> NDArray[Any]:
        values = [
            np.einsum("nk,nk->n", channel.directions[direction], channel.texels[texel])
            for channel in self.btf.channels
        ]
        return self.btf.colours(np.stack(values, -1))
