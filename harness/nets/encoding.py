"""What a network sees of a condition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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


@dataclass(frozen=True)
class Group:
    """Columns that are encoded alike.

    With ``frequencies`` as :func:`sinusoids_columns` has it; without, (v - ``mean``) * ``scale``,
    one of each a column, or as they are where those are empty.
    """

    columns: Columns
    frequencies: int | None = None
    mean: Sequence[float] = ()
    scale: Sequence[float] = ()

    @property
    def width(self) -> int:
        """Inputs of a network."""
        return len(self.columns) * (1 if self.frequencies is None else 1 + 2 * self.frequencies)


@dataclass(frozen=True)
class Encoded:
    """Inputs of a network as the columns that they are made of, so that it may encode them itself.

    Example:
        >>> Encoded.waves([x], 4) + net.encoder.encoded(c)  # 9 inputs of x and 30 of the condition
    """

    groups: tuple[Group, ...]

    @classmethod
    def plain(cls, columns: Columns) -> Encoded:
        """Columns as they are."""
        return cls((Group(columns),))

    @classmethod
    def waves(cls, columns: Columns, frequencies: int) -> Encoded:
        """With sines and cosines, see :func:`sinusoids_columns`."""
        return cls((Group(columns, frequencies),))

    def __add__(self, other: Encoded) -> Encoded:
        return Encoded(self.groups + other.groups)

    @property
    def width(self) -> int:
        """Inputs of the network."""
        return sum(group.width for group in self.groups)

    @property
    def raw(self) -> Columns:
        """The columns before they are encoded."""
        return [column for group in self.groups for column in group.columns]

    @property
    def as_it_is(self) -> bool:
        """Whether :attr:`raw` are the network's inputs."""
        return all(group.frequencies is None and not group.mean for group in self.groups)

    @cached_property
    def inputs(self) -> Columns:
        """The network's inputs."""
        found: Columns = []
        for group in self.groups:
            if group.frequencies is not None:
                found += sinusoids_columns(group.columns, group.frequencies)
            elif group.mean:
                numbers = zip(group.columns, group.mean, group.scale, strict=True)
                found += [(column - mean) * scale for column, mean, scale in numbers]
            else:
                found += group.columns
        return found


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

    def encoded(self, c: Columns) -> Encoded:
        """The same over columns, for a network to encode."""
        a, f = self.n_address, self.n_features
        features = Group(c[a : a + f], None, self.mean.tolist(), self.scale.tolist())
        waves = Group(c[a + f : a + f + 2], self.frequencies)
        return Encoded((features, waves) if f else (waves,))

    def columns(self, c: Columns) -> list[Float]:
        """The same over columns."""
        return self.encoded(c).inputs
