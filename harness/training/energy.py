r"""Ends a training with energies, which tracing knows far better than single reflectances.

The energy of a place and a camera is the integral of f over the disk; a path that chooses its way
by the BSDF knows it to a half, a query of f to a few times itself. Where the camera grazes, most of
it comes from a narrow part of the disk that few queries fall into. With two independent estimates
a, b of the network's energy and one, y, of the surface's, a step goes along

.. math:: \frac{(b - y)\,\nabla a}{(\mathrm{sg}(a) + \varepsilon)^2} +
          \frac{(a - y)\,\nabla b}{(\mathrm{sg}(b) + \varepsilon)^2}

which vanishes in the mean where the energies agree: no product holds one estimate's noise twice,
as the square of a - y would.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from harness.core.streams import generator
from harness.materials.neural.network import NeuralMBTF
from harness.microgeometry import queries
from harness.training.optimiser import adam
from harness.training.training import Data, Training

CONDITIONS = 1 << 23
"""Whose energy is traced at most."""
_PATHS = 4
STEP = 1 << 10
"""Conditions of a step."""
_PART = 1 << 8
"""Of them, those whose rows stay in a processor's cache together."""
_SIDE = 8
"""Squared, the directions of one estimate."""
_WEIGHT, _FLOOR = 0.3, 0.05
_RATES = (1.8e-3, 1.2e-3)
"""Of the texture and of the decoder at first; they fall to nothing along a cosine."""
_GRAZING = 0.3
"""Of the conditions, the share whose cameras are uniform in the cosine, and not on the disk."""


class Known(NamedTuple):
    """Conditions, and estimates of the energies there."""

    u: Tensor
    """[N, 2]"""
    wi: Tensor
    """[N, 2]"""
    energy: Tensor
    """[N, 3]"""


def able(surface: Any, network: NeuralMBTF) -> bool:
    """Whether energies can be traced, and the network is of a single footprint."""
    return callable(getattr(surface, "energy", None)) and not network.architecture.pyramid


def draw(surface: Any, kernel: float, n: int, seed: int, device: str = "cpu") -> Known:
    """``n`` random conditions and their energies by a few paths each, all on ``device``."""
    random = torch.rand(n, 5, generator=generator(seed))
    u, drawn, angle = random[:, :2], random[:, 2], 2 * math.pi * random[:, 3]
    squared = torch.where(random[:, 4] < _GRAZING, 1 - drawn.square(), drawn)
    # Four steps of the floats inside the rim, as square_to_disk has it.
    radius = squared.sqrt() * (1 - 4 * torch.finfo(squared.dtype).eps)
    wi = radius[:, None] * torch.stack([angle.cos(), angle.sin()], 1)
    u, wi = u.to(device).contiguous(), wi.to(device)
    found, _ = queries.energy(surface, u, u.new_full((n,), kernel), wi, _PATHS, seed, device=device)
    return Known(u, wi, found)


def teach(
    training: Training,
    known: Known,
    data: Data,
    steps: int,
    seed: int,
    notify: Callable[[float], None] = lambda _share: None,
) -> float:
    """``steps`` more steps with ``data`` and ``known``; the offset stands. Returns the seconds.

    Raises:
        FloatingPointError: the loss of the queries became nan or infinite.
    """
    start = time.perf_counter()
    network, batch = training.network, training.profile.final_batch
    optimiser = adam([[network.texture], network.decoder.parameters()])
    random = generator(seed)
    count = min(STEP, len(known.u))
    for step in range(steps):
        fall = 0.5 * (1 + math.cos(math.pi * step / steps))
        for group, rate in zip(optimiser.param_groups, _RATES, strict=True):
            group["lr"] = rate * fall
        first = int(torch.randint(len(data), (), generator=random))
        error = training.gradient(data.block(first, min(batch, len(data))))
        at = int(torch.randint(len(known.u) - count + 1, (), generator=random))
        for part in range(at, at + count, _PART):
            rows = slice(part, min(part + _PART, at + count))
            some = Known(*(x[rows] for x in known))
            directions = int(torch.randint(1 << 62, (), generator=random))
            weight = _WEIGHT * len(some.u) / count
            (weight * loss(network, some, directions)).backward()
        optimiser.step()
        if step % max(1, steps // 100) == 0:
            if not math.isfinite(error):
                raise FloatingPointError(f"loss is {error} at step {step} of the energies")
            notify(step / steps)
    seconds = time.perf_counter() - start
    training.seconds += seconds
    return seconds


def loss(network: NeuralMBTF, known: Known, seed: int) -> Tensor:
    """What has the gradient above, in the mean over conditions and channels. Not the error."""
    n, wo = len(known.u), queries.stratified(2 * len(known.u), _SIDE, seed).to(known.u.device)
    wo = wo.view(n, -1, 2)
    features = network.features(known.u, known.wi)
    rows = [x[:, None].expand(-1, wo.shape[1], -1).flatten(0, 1) for x in (features, known.wi)]
    f = network.reflectance(*rows, wo.flatten(0, 1)).view(n, 2, -1, 3)
    a, b = (math.pi * f.mean(2)).unbind(1)
    steps = (
        mine * (other.detach() - known.energy) / (mine.detach() + _FLOOR).square()
        for mine, other in ((a, b), (b, a))
    )
    return sum(steps).mean()
