r"""What a flow of the plane starts from: Gaussians whose parameters a condition gives.

``normal``: the standard normal, whatever the condition. ``gaussian``: one axis-aligned Gaussian,
its mean and log standard deviations from a network. ``lobes``: two of them and their weights.
Beside any of these a *share* s of the standard normal, fixed or a condition's own, if it is
*mixed*; otherwise the network gives the share for others to use.

.. math:: p_0(x) = s\,\mathcal{N}(x; 0, 1)
          + (1 - s) \sum_l w_l\,\mathcal{N}(x; \mu_l, \sigma_l)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.nets import defensive, lobes
from harness.nets.encoding import Encoded
from harness.nets.mlp import MLP

BASES = ("normal", "gaussian", "lobes")


class Mixture(NamedTuple):
    """``log_weight`` [B, L] normalised, ``mean`` and ``log_sigma`` [B, L, 2]; ``raw_share`` [B, 1]
    is the logit of the condition's own share, if it has one."""

    log_weight: Tensor
    mean: Tensor
    log_sigma: Tensor
    raw_share: Tensor | None = None

    def rows(self, index: Tensor) -> Mixture:
        """Those of some conditions."""
        return Mixture(*(None if part is None else part[index] for part in self))

    def framed(self, mean: Tensor, log_sigma: Tensor) -> Mixture:
        """In the coordinates (x - mean) / sigma, both [B, 1, 2]."""
        return self._replace(
            mean=(self.mean - mean) * torch.exp(-log_sigma), log_sigma=self.log_sigma - log_sigma
        )

    def log_prob(self, x: Tensor) -> Tensor:
        """Log density [B, D] at ``x`` [B, D, 2]."""
        z = (x[:, :, None] - self.mean[:, None]) * torch.exp(-self.log_sigma)[:, None]
        each = -0.5 * z.square().sum(-1) - self.log_sigma.sum(-1)[:, None] - lobes.LOG_2PI
        return torch.logsumexp(each + self.log_weight[:, None], -1)

    def place(self, z: Tensor, pick: Tensor) -> Tensor:
        """Samples [B, D, 2] from normals ``z`` [B, D, 2]; uniforms ``pick`` [B, D] choose."""
        ends = self.log_weight.exp().cumsum(-1)[:, None, :-1]
        which = (pick[..., None] >= ends).sum(-1)[..., None].expand_as(z)
        mean, log_sigma = self.mean.gather(1, which), self.log_sigma.gather(1, which)
        return mean + z * torch.exp(log_sigma)


class ColumnMixture(NamedTuple):
    """The same over columns; a lobe's mean and log sigma are pairs, ``share`` no logit."""

    weight: Columns
    mean: list[Columns]
    log_sigma: list[Columns]
    share: Float | float = 0.0

    def framed(self, mean: Columns, log_sigma: Columns) -> ColumnMixture:
        """In the coordinates (x - mean) / sigma."""
        return self._replace(
            mean=[
                [(m - o) * dr.exp(-s) for m, o, s in zip(pair, mean, log_sigma, strict=True)]
                for pair in self.mean
            ],
            log_sigma=[
                [a - s for a, s in zip(pair, log_sigma, strict=True)] for pair in self.log_sigma
            ],
        )

    def pdf(self, x: Columns) -> Float:
        """Density at ``x``."""
        total = None
        for weight, mean, log_sigma in zip(self.weight, self.mean, self.log_sigma, strict=True):
            zx, zy = ((v - m) * dr.exp(-s) for v, m, s in zip(x, mean, log_sigma, strict=True))
            log_normal = -0.5 * dr.fma(zx, zx, zy * zy) - log_sigma[0] - log_sigma[1]
            part = weight * dr.exp(log_normal - lobes.LOG_2PI)
            total = part if total is None else total + part
        return total

    def place(self, z: Columns, pick: Float) -> Columns:
        """A sample from two normals, its lobe chosen by a uniform."""
        x, end = None, 0
        for weight, mean, log_sigma in zip(self.weight, self.mean, self.log_sigma, strict=True):
            here = [dr.fma(v, dr.exp(s), m) for v, m, s in zip(z, mean, log_sigma, strict=True)]
            # Weights sum to one but for rounding: whatever is left belongs to the last lobe.
            if x is not None:
                here = [dr.select(pick >= end, a, b) for a, b in zip(here, x, strict=True)]
            x, end = here, end + weight
        return x


class MixtureBase(nn.Module):
    """The network E-``width``-outputs of a base, or none.

    ``share`` is the least weight of the standard normal; ``own_share`` has the network give it,
    from there up to one. Outputs: means, log sigmas, logits of two lobes, logit of the share.
    ``mixed`` says whether the base itself has it. ``wide`` is the standard deviation to start
    from. Log sigmas are kept within 10 by :func:`harness.nets.lobes.log_sigma` unless ``bounded``
    is false.
    """

    def __init__(
        self,
        kind: str,
        encoded: int,
        width: int,
        share: float = 0.0,
        own_share: bool = False,
        mixed: bool = True,
        wide: float = 1.0,
        activation: str = "leaky_relu",
        bounded: bool = True,
    ):
        super().__init__()
        self.kind, self.share, self.own_share = kind, share, own_share
        self.mixed, self.bounded = mixed, bounded
        self.lobes = {"normal": 0, "gaussian": 1, "lobes": 2}[kind]
        n = self.lobes
        outputs = self._logits + own_share
        self.net = None
        if outputs:
            self.net = MLP([encoded, width, outputs], activation, zero_last=True)
            with torch.no_grad():
                bias = self.net.layers[-1].bias
                bias[2 * n : 4 * n] = math.log(wide)
                if n > 1:
                    # Two that start alike would stay alike: one is narrower.
                    bias[2 * n + 2 : 4 * n] -= 1.0

    def forward(self, encoded: Tensor) -> Mixture:
        """The mixture at [B, E]."""
        n, rows = self.lobes, len(encoded)
        out = encoded.new_zeros(rows, 0) if self.net is None else self.net(encoded)
        mean, raw, logits = out[:, : 2 * n], out[:, 2 * n : 4 * n], out[:, 4 * n : self._logits]
        raw = lobes.log_sigma(raw) if self.bounded else raw
        mean, log_sigma = mean.reshape(rows, n, 2), raw.reshape(rows, n, 2)
        weight = lobes.log_weight(logits) if n > 1 else out.new_zeros(rows, n)
        raw_share = out[:, -1:] if self.own_share else None
        if n and not self._has_normal:
            return Mixture(weight, mean, log_sigma, raw_share)
        still = out.new_zeros(rows, 1, 2)
        mean, log_sigma = torch.cat([still, mean], 1), torch.cat([still, log_sigma], 1)
        if n == 0:
            return Mixture(still[..., 0], mean, log_sigma, raw_share)
        part, rest = self._log_shares(out)
        return Mixture(torch.cat([part, weight + rest], 1), mean, log_sigma, raw_share)

    @property
    def _has_normal(self) -> bool:
        return self.mixed and (self.share > 0 or self.own_share)

    @property
    def _logits(self) -> int:
        """Where the outputs of the lobes end."""
        return 4 * self.lobes + (self.lobes if self.lobes > 1 else 0)

    def _log_shares(self, out: Tensor) -> tuple[Tensor, Tensor]:
        """Logarithms [B, 1] of the standard normal's weight and of what it leaves."""
        if not self.own_share:
            one = out.new_ones(len(out), 1)
            return one * math.log(self.share), one * math.log1p(-self.share)
        raw, least = out[:, -1:], self.share
        rest = nn.functional.logsigmoid(-raw) + math.log1p(-least)
        part = nn.functional.logsigmoid(raw) + math.log1p(-least)
        if least > 0:
            part = torch.logaddexp(part, torch.full_like(part, math.log(least)))
        return part, rest

    def columns(self, encoded: Encoded) -> ColumnMixture:
        """The mixture over columns."""
        array, n = type(encoded.raw[-1]), self.lobes
        out = [] if self.net is None else self.net.columns(encoded)
        raw = out[2 * n : 4 * n]
        raw = [lobes.log_sigma_columns(v) for v in raw] if self.bounded else raw
        mean = [out[2 * i : 2 * i + 2] for i in range(n)]
        log_sigma = [raw[2 * i : 2 * i + 2] for i in range(n)]
        weight = lobes.weight_columns(out[4 * n : self._logits]) if n > 1 else [array(1)] * n
        share = defensive.share_columns(out[-1], self.share) if self.own_share else self.share
        if n and not self._has_normal:
            return ColumnMixture(weight, mean, log_sigma, share)
        still = [array(0), array(0)]
        if n == 0:
            return ColumnMixture([array(1)], [still], [still], share)
        weight = [array(share), *((1 - share) * w for w in weight)]
        return ColumnMixture(weight, [still, *mean], [still, *log_sigma], share)
