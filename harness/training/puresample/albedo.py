r"""Fits the albedo to counts of the particles that come back.

Of n particles k leave, k / n estimating the albedo a. Losses of the network's answer q:

``survival``: the counts' likelihood, :math:`-\frac kn \log q - (1 - \frac kn) \log(1 - q)`;
``squared``: :math:`(q - \frac kn)^2`. Both are linear in k / n but for what does not depend on q,
so the minimiser of their mean is the mean of k / n, which is a, whatever n: they are unbiased.

``l1``: :math:`|q - \frac kn|`, the published loss. Its minimiser is the *median* of k / n. That of
a binomial count lies within one of n a, so the answer is off by up to 1 / n, and is 0 where
:math:`(1 - a)^n > \frac12`. A dark material or a small n is where it shows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError, nearest
from harness.core.streams import generator
from harness.materials.puresample.network import CHANNELS, PureSample
from harness.microgeometry.walks.kernel import Counts
from harness.training.puresample.data import LANES
from harness.training.puresample.density import variation
from harness.training.puresample.descent import Notify, UnderWay, descend
from harness.training.puresample.profiles import ALBEDO_LOSSES, Profile


class Survival(NamedTuple):
    """Places [N, 2], directions [N, 2] and shares [N, 3] of the particles that left."""

    u: Tensor
    wi: Tensor
    share: Tensor
    group: int
    """Particles of each channel that a share is of."""
    counts: Counts

    @property
    def error(self) -> Tensor:
        """Standard errors [N, 3] of the shares: the binomial's, of its estimated parameter."""
        spread = self.share * (1 - self.share) / (self.group - 1)
        return spread.clamp(min=0).sqrt()


def draw(
    source: Any, directions: int, group: int, seed: int, device: str = "cpu", spread: bool = False
) -> Survival:
    """``group`` particles a channel from each of so many random directions, and places.

    All of a direction start at one place, or with ``spread`` each at its own, which knows the mean
    over the tile better.
    """
    random = generator(seed)
    u = torch.rand(directions, 2, generator=random)
    wi = square_to_disk(torch.rand(directions, 2, generator=random))
    return at(source, u, wi, group, seed + 1, device, spread)


def at(
    source: Any, u: Tensor, wi: Tensor, group: int, seed: int, device: str, spread: bool = False
) -> Survival:
    """The same at given places and directions; ``spread`` takes a new place for each particle."""
    repeats, counts = CHANNELS * group, Counts()
    rows, parts = max(1, LANES // repeats), []
    channel = torch.arange(CHANNELS).repeat_interleave(group)
    for first in range(0, len(u), rows):
        here, from_ = (x[first : first + rows].repeat_interleave(repeats, 0) for x in (u, wi))
        if spread:
            here = torch.rand(here.shape, generator=generator(seed + 7 + first))
        of = channel.repeat(len(here) // repeats)
        found = source.walk(here, from_, of, seed + first, device)
        counts.add(found.counts)
        parts.append(found.left.cpu().view(-1, CHANNELS, group).double().mean(-1).float())
    return Survival(u, wi, torch.cat(parts), group, counts)


def loss_of(kind: str, logit: Tensor, share: Tensor) -> Tensor:
    """See the module; ``logit`` and ``share`` are [N, 3]."""
    if kind not in ALBEDO_LOSSES:
        raise InputError(f"albedo_loss: unknown '{kind}'{nearest(kind, ALBEDO_LOSSES)}")
    if kind == "survival":
        return torch.nn.functional.binary_cross_entropy_with_logits(logit, share)
    away = torch.sigmoid(logit) - share
    return away.square().mean() if kind == "squared" else away.abs().mean()


def fit(
    network: PureSample,
    data: Survival,
    profile: Profile,
    seed: int,
    device: str,
    notify: Notify,
    under_way: UnderWay | None = None,
) -> float:
    """The albedo's network, and those channels of the texture that are its own: the density's stand
    still. Returns the last loss."""
    random = torch.Generator().manual_seed(seed)
    u, wi, share = (x.to(device) for x in data[:3])
    if under_way is None or "albedo" not in under_way.begun:
        _start(network, share)

    def loss() -> Tensor:
        index = torch.randint(len(wi), (profile.albedo_batch,), generator=random).to(device)
        # A texture without channels of the albedo's own stands still as a whole.
        with torch.set_grad_enabled(a.albedo_channels > 0):
            features = network.features_beside(u[index])
        logit = network.albedo_logit(features, wi[index])
        found = loss_of(profile.albedo_loss, logit, share[index])
        return found + profile.tv * variation(network, a.channels, a.features)

    a = network.architecture
    groups = [(list(network.albedo_net.parameters()), profile.albedo_rate)]
    if a.albedo_channels:
        groups.append(([network.texture], profile.texture_rate))
    return descend(loss, groups, profile.albedo_steps, notify, "albedo", network, random, under_way)


def _start(network: PureSample, share: Tensor) -> None:
    """The mean share everywhere."""
    with torch.no_grad():
        # A survivor more, so that the start is finite where none came back.
        mean = (share.mean(0) * len(share) + 0.5) / (len(share) + 1)
        _last(network).bias.copy_(torch.logit(mean))


def _last(network: PureSample) -> torch.nn.Linear:
    net = network.albedo_net
    return (net.leave if network.architecture.residual else net).layers[-1]
