"""What a network sees of a condition."""

from __future__ import annotations

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float

_NO_PHASE = float(2**24)


def sinusoids(x: Tensor, frequencies: int) -> Tensor:
    """``x`` and its sines and cosines at 1, 2, 4, ...: [..., D] -> [..., D (1 + 2 F)]."""
    parts = [x]
    for k in range(frequencies):
        parts += [torch.sin(x * 2**k), torch.cos(x * 2**k)]
    return torch.cat(parts, -1)


def sinusoids_columns(x: Columns, frequencies: int) -> Columns:
    """:func:`sinusoids` over columns, higher frequencies by the double-angle formulas.

    Beyond 2^24, where neighbouring numbers are further apart than a radian and have no phase, the
    angle is taken as zero: Dr.Jit's sine is infinite from 1e9 on.
    """
    parts = list(x)
    # So compared, a nan stays one.
    waves = [dr.sincos(dr.select(dr.abs(v) > _NO_PHASE, 0, v)) for v in x]
    for k in range(frequencies):
        parts += [s for s, _ in waves] + [c for _, c in waves]
        if k + 1 < frequencies:
            waves = [(2 * s * c, dr.fma(-2 * s, s, 1)) for s, c in waves]
    return parts


class ConditionEncoder(nn.Module):
    """Condition rows as network inputs: standardised features, then encoded ``wi.xy``.

    [N, n_address + F + 2] -> [N, width], width = F + 2 (1 + 2 ``frequencies``); 30 for the
    eight features and five frequencies of NeuSample. Address columns are left out: they
    say where a row is, not what is there. :meth:`standardise` sets the features' mean and
    deviation from the conditions of a fit.
    """

    def __init__(self, n_address: int, n_features: int, frequencies: int = 5):
        super().__init__()
        self.n_address, self.n_features, self.frequencies = n_address, n_features, frequencies
        self.width = n_features + 2 * (1 + 2 * frequencies)
        self.register_buffer("mean", torch.zeros(n_features))
        self.register_buffer("scale", torch.ones(n_features))

    def standardise(self, condition: Tensor) -> None:
        """Set mean and scale of the features from ``condition`` [N, C]."""
        if self.n_features == 0:
            return
        features = condition[:, self.n_address : self.n_address + self.n_features]
        deviation = features.std(0, correction=0)
        self.mean.copy_(features.mean(0))
        # A feature that never varies carries nothing; any finite scale will do.
        self.scale.copy_(torch.where(deviation > 0, 1 / deviation, torch.ones_like(deviation)))

    def forward(self, condition: Tensor) -> Tensor:
        """[..., C] -> [..., width]."""
        a, f = self.n_address, self.n_features
        features = (condition[..., a : a + f] - self.mean) * self.scale
        return torch.cat([features, sinusoids(condition[..., a + f :], self.frequencies)], -1)

    def columns(self, c: Columns) -> list[Float]:
        """The same over columns."""
        a, f = self.n_address, self.n_features
        mean, scale = self.mean.tolist(), self.scale.tolist()
        features = [(c[a + i] - mean[i]) * scale[i] for i in range(f)]
        return features + sinusoids_columns(c[a + f : a + f + 2], self.frequencies)
