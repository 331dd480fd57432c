"""The networks of a conditional flow of the projected disk: encoder, base and velocity."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.material import Material
from harness.nets import defensive, domains
from harness.nets.discrete_flow import ROUNDS, DiscreteFlow
from harness.nets.encoding import ConditionEncoder, Encoded, Group
from harness.nets.mixture_base import ColumnMixture, Mixture, MixtureBase
from harness.nets.velocity import Shared, Velocity

_FEATURES = 8.0


class Conditioned(NamedTuple):
    """What conditions determine: base and first layer's share, and the frame, [B, 1, 2] each.

    The flow's coordinates are (domain's place - mean) / sigma; None where they are the place.
    """

    base: Mixture
    shared: Tensor
    mean: Tensor | None
    log_sigma: Tensor | None


class ColumnConditioned(NamedTuple):
    """The same over columns."""

    base: ColumnMixture
    shared: Shared
    mean: Columns | None
    log_sigma: Columns | None


class ConditionalFlow(nn.Module):
    r"""Condition -> base; base point, time and condition -> velocity, in one of the domains.

    Features are seen as :math:`8 \tanh(f / 8)` of their standardised values: a material's own
    hardly change, and values that no fit has met do not blow up a velocity.

    The uniform ``share`` (with ``own_share`` a condition's own, from there up to one) is part of
    the base in the domain ``plane``, where the standard normal is the uniform disk; elsewhere it
    is mixed with the density on the disk.

    ``framed`` has the flow act on coordinates in which the base's first Gaussian is the standard
    normal: a narrow lobe is then as easy to bend as a broad one.

    ``bounded`` keeps log sigmas and the places that the velocity sees within bounds, see there.
    """

    def __init__(
        self,
        material: Material,
        *,
        base: str = "normal",
        base_width: int = 32,
        domain: str = "disk",
        width: int = 64,
        layers: int = 5,
        activation: str = "silu",
        frequencies: int = 5,
        share: float = 0.0,
        own_share: bool = False,
        framed: bool = False,
        waves: int = 0,
        bounded: bool = True,
        base_activation: str = "leaky_relu",
    ):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features, frequencies)
        self.domain, self.share, self.own_share = domain, share, own_share
        inside = domain == "plane"
        self.base = MixtureBase(
            base,
            self.encoder.width,
            base_width,
            share,
            own_share,
            mixed=inside,
            wide=1.0 if inside else 0.5,
            activation=base_activation,
            bounded=bounded,
        )
        self.velocity = Velocity(self.encoder.width, width, layers, activation, bounded, waves)
        self.framed = framed and self.base.lobes > 0

    def encode(self, condition: Tensor) -> Tensor:
        """What the networks see, [B, E]."""
        encoded, n = self.encoder(condition), self.encoder.n_features
        features = _FEATURES * torch.tanh(encoded[:, :n] / _FEATURES)
        return torch.cat([features, encoded[:, n:]], 1)

    def at(self, condition: Tensor) -> Conditioned:
        """All that [B, C] conditions determine, in the flow's coordinates."""
        encoded = self.encode(condition)
        base, shared = self.base(encoded), self.velocity.shared(encoded)
        if not self.framed:
            return Conditioned(base, shared, None, None)
        main = slice(-self.base.lobes, base.mean.shape[1] - self.base.lobes + 1)
        mean, log_sigma = base.mean[:, main], base.log_sigma[:, main]
        return Conditioned(base.framed(mean, log_sigma), shared, mean, log_sigma)

    def place(self, at: Conditioned, wo: Tensor) -> tuple[Tensor, Tensor]:
        """Flow coordinates [B, D, 2] of ``wo``, and log |d place / d wo| [B, D]."""
        place, log_slope = domains.from_disk(self.domain, wo)
        if at.mean is None:
            return place, log_slope
        place = (place - at.mean) * torch.exp(-at.log_sigma)
        return place, log_slope - at.log_sigma.sum(-1)

    def direction(self, at: Conditioned, place: Tensor) -> Tensor:
        """The direction of a place: the inverse of :meth:`place`."""
        if at.mean is not None:
            place = at.mean + place * torch.exp(at.log_sigma)
        return domains.to_disk(self.domain, place)

    def draw(self, base: Mixture, count: int, generator: torch.Generator) -> Tensor:
        """Samples [B, count, 2] of a base; by the generator's own, on whatever device."""
        z = torch.randn(len(base.mean), count, 2, generator=generator, dtype=base.mean.dtype)
        pick = torch.rand(len(base.mean), count, generator=generator)
        return base.place(z.to(base.mean.device), pick.to(base.mean.device))

    def log_prob(
        self, flow: DiscreteFlow, condition: Tensor, wo: Tensor, rounds: int = ROUNDS
    ) -> tuple[Tensor, Tensor]:
        """Log density [B, D] of the samples of ``flow`` at ``wo`` [B, D, 2]; where it was found.

        Differentiable; without gradients wanted, by the plain inverse.
        """
        at = self.at(condition)
        place, log_slope = self.place(at, wo)
        if torch.is_grad_enabled():
            origin = flow.origin(place, at.shared, rounds)
        else:
            origin = flow.invert(place, at.shared)
        log_prob = at.base.log_prob(origin.x) - origin.log_det + log_slope
        return self.mixed(log_prob, wo, at.base), origin.found

    def outer_share(self, base: Mixture) -> Tensor | float:
        """The uniform share [B] beside the base, where the base does not have it: else zero."""
        if self.domain == "plane":
            return 0.0
        if base.raw_share is None:
            return self.share
        return self.share + (1 - self.share) * torch.sigmoid(base.raw_share[:, 0])

    def mixed(self, log_prob: Tensor, wo: Tensor, base: Mixture) -> Tensor:
        """With the uniform share, where the base does not have it."""
        if self.domain == "plane":
            return log_prob
        if base.raw_share is not None:
            return defensive.log_mixed_logit(log_prob, wo, base.raw_share, self.share)
        return defensive.log_mixed(log_prob, wo, self.share)

    # --- the same over columns ---------------------------------------------------------

    def at_columns(self, c: Columns) -> ColumnConditioned:
        """See :meth:`at`."""
        encoded = self._encoded(c)
        base, shared = self.base.columns(encoded), self.velocity.shared_columns(encoded)
        if not self.framed:
            return ColumnConditioned(base, shared, None, None)
        mean, log_sigma = base.mean[-self.base.lobes], base.log_sigma[-self.base.lobes]
        return ColumnConditioned(base.framed(mean, log_sigma), shared, mean, log_sigma)

    def _encoded(self, c: Columns) -> Encoded:
        """See :meth:`encode`; sines and cosines are left to the networks."""
        groups = self.encoder.encoded(c).groups
        if not self.encoder.n_features:
            return Encoded(groups)
        features = Encoded(groups[:1]).inputs
        features = [_FEATURES * dr.tanh(v * (1 / _FEATURES)) for v in features]
        return Encoded((Group(features), *groups[1:]))

    def place_columns(self, at: ColumnConditioned, wo: Columns) -> tuple[Columns, Float]:
        """See :meth:`place`; the slope itself."""
        place, slope = domains.from_disk_columns(self.domain, wo)
        if at.mean is None:
            return place, slope
        place = [(v - m) * dr.exp(-s) for v, m, s in zip(place, at.mean, at.log_sigma, strict=True)]
        return place, slope * dr.exp(-at.log_sigma[0] - at.log_sigma[1])

    def direction_columns(self, at: ColumnConditioned, place: Columns) -> Columns:
        """See :meth:`direction`."""
        if at.mean is not None:
            place = [
                dr.fma(v, dr.exp(s), m)
                for v, m, s in zip(place, at.mean, at.log_sigma, strict=True)
            ]
        return domains.to_disk_columns(self.domain, place)
