"""Fits density and latent texture to the directions of particles that left."""

from __future__ import annotations

import torch
from torch import Tensor

from harness.core.protocol.method import Budget
from harness.fitting.flow_matching import likelihood_loss, matching_loss
from harness.materials.puresample.network import PureSample
from harness.training.puresample.data import Walked
from harness.training.puresample.descent import Notify, UnderWay, descend
from harness.training.puresample.profiles import Profile


class Rows:
    """Batches of particles as the losses of a flow ask for them: one direction a condition.

    They call ``batch(conditions, generator)``, as of :class:`harness.fitting.drawn.Drawn`.
    """

    def __init__(self, network: PureSample, data: Walked, device: str):
        self.network, self.device = network, device
        parts = (data.u, data.wi, data.channel, data.wo)
        self.u, self.wi, self.channel, self.wo = (x.to(device) for x in parts)

    def batch(self, rows: int, random: torch.Generator) -> tuple[Tensor, Tensor]:
        """Conditions [B, C] and directions [B, 1, 2] of ``rows`` particles."""
        index = torch.randint(len(self.wo), (rows,), generator=random).to(self.device)
        features = self.network.features(self.u[index])
        condition = self.network.condition(features, self.channel[index], self.wi[index])
        return condition, self.wo[index][:, None]


def fit(
    network: PureSample,
    data: Walked,
    profile: Profile,
    seed: int,
    device: str,
    notify: Notify,
    under_way: UnderWay | None = None,
) -> dict[str, float]:
    """Both phases; ``data`` are particles that left. Returns the last losses."""
    rows, random = Rows(network, data, device), torch.Generator().manual_seed(seed)
    a, net, losses = network.architecture, network.density, {}

    def groups(rate: float) -> list:
        found = [(list(net.parameters()), rate)]
        if network.texture is not None:
            found.append(([network.texture], profile.texture_rate * rate / profile.matching_rate))
        return found

    def matching() -> Tensor:
        budget = Budget(conditions=profile.matching_batch, directions=1)
        found = matching_loss(net, rows, budget, random, pairing=False)
        return found + profile.tv * variation(network, 0, a.channels)

    def likelihood() -> Tensor:
        budget = Budget(conditions=profile.likelihood_batch, directions=1)
        found = likelihood_loss(net, a.steps, "euler", rows, budget, random)
        return found + profile.tv * variation(network, 0, a.channels)

    for what, loss, steps, rate in (
        ("matching", matching, profile.matching_steps, profile.matching_rate),
        ("likelihood", likelihood, profile.likelihood_steps, profile.likelihood_rate),
    ):
        if steps:
            losses[what] = descend(
                loss, groups(rate), steps, notify, what, network, random, under_way
            )
    return losses


def variation(network: PureSample, first: int, last: int) -> Tensor | float:
    """Total variation of the texture's channels from ``first`` to ``last``, which is not of them,
    eq. 4, as a mean over texels and channels; the texture wraps."""
    if network.texture is None or first == last:
        return 0.0
    side = network.architecture.resolution
    image = network.texture.view(side, side, -1)[..., first:last]
    return (image.roll(-1, 0) - image).abs().mean() + (image.roll(-1, 1) - image).abs().mean()
