"""The normalizing-flow baseline of NeuSample: two affine couplings, after Xie et al. (2019)."""

from __future__ import annotations

from typing import ClassVar

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Knob
from harness.fitting.flow_method import FlowMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.nets import defensive, lobes
from harness.nets.coupling import CouplingNet, unit_normal_columns
from harness.nets.encoding import ConditionEncoder, Encoded
from harness.nets.extremes import FAR, held


class AffineFlow(nn.Module):
    """Conditioners of two outputs each, log scale and shift; the base's mean and log sigma.

    Coupling i moves x given y where i is even, y given x where it is odd.
    """

    def __init__(
        self,
        material: Material,
        width: int,
        layers: int,
        couplings: int,
        frequencies: int,
        trainable: bool,
    ):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features)
        self.couplings = nn.ModuleList(
            CouplingNet(self.encoder.width, width, 2, frequencies, layers) for _ in range(couplings)
        )
        self.mean = nn.Parameter(torch.zeros(2), requires_grad=trainable)
        self.raw_sigma = nn.Parameter(torch.zeros(2), requires_grad=trainable)

    @property
    def x_given_y(self) -> CouplingNet:
        """The first coupling."""
        return self.couplings[0]

    @property
    def y_given_x(self) -> CouplingNet:
        """The second."""
        return self.couplings[1]


class RealNVP(FlowMethod):
    r"""Two affine couplings: Xie et al. (2019), after Dinh et al. (2016).

    .. math:: x' = x\,e^{s(y)} + t(y), \quad y' = y\,e^{s'(x')} + t'(x'), \quad
              p(\omega) = \mathcal{N}(x', y')\,e^{s(y) + s'(x')}

    The scales and shifts are given by networks of two hidden layers of 32 (LeakyReLU,
    slope 0.01; 39-32-32-2) that see the other coordinate, encoded with four frequencies,
    and the encoded condition. Their last layers start at zero: the flow starts as its base,
    a standard normal. ``base="trainable"`` fits its mean and deviation too, the same for
    all conditions, where the public release offers both.

    ``couplings`` is how many affine maps in turn, x first; the paper has two.

    The density is per disk area and does not vanish outside: samples there are invalid.
    Log scales are kept within 10 by :func:`harness.nets.lobes.log_sigma`, a deviation from
    the paper that changes nothing where they live. A share ``uniform`` of the samples is
    uniform on the disk (:mod:`harness.nets.defensive`); 0 is the flow as published, whose
    density underflows beside narrow lobes. Uses three uniforms.
    """

    name = "realnvp"
    learning_rate = 1e-2

    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("couplings", (1, 2, 4, 6), "affine maps in turn, alternating x and y"),
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers of a coupling's network"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self,
        width: int = 32,
        frequencies: int = 4,
        base: str = "fixed",
        uniform: float = 0.01,
        layers: int = 2,
        couplings: int = 2,
        precision: str = "float32",
    ):
        if base not in ("fixed", "trainable"):
            raise InputError(f"{self.name}: base is '{base}'; expected 'fixed' or 'trainable'")
        if min(couplings, layers) < 1:
            raise InputError(
                f"{self.name}: expected at least one of couplings and layers,"
                f" not {couplings} and {layers}"
            )
        self.width, self.layers, self.couplings = width, layers, couplings
        self.frequencies, self.trainable = frequencies, base == "trainable"
        self.uniform = defensive.checked_share(uniform, self.name)
        self.precision = checked_precision(precision, self.name)

    def build(self, material: Material) -> nn.Module:
        """See :meth:`ModuleMethod.build`."""
        return AffineFlow(
            material, self.width, self.layers, self.couplings, self.frequencies, self.trainable
        )

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: samples drawn together and apart by all couplings.

        A coupling's scale is applied on the way to the base, so the largest makes samples
        closest.
        """
        found = {}
        for name, raw in (("scale-to-0", FAR), ("scale-to-infinity", -FAR)):
            state = self.state_dict()
            for i in range(self.couplings):
                state = held(state, f"couplings.{i}.mlp.layers.{self.layers}", slice(0, 1), raw)
            found[name] = state
        return found

    def to_base(self, net: AffineFlow, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`FlowMethod.to_base`."""
        encoded = net.encoder(condition)
        log_sigma = lobes.log_sigma(net.raw_sigma)
        at = list(wo.unbind(-1))
        log_scale = -log_sigma.sum()
        for i, coupling in enumerate(net.couplings):
            own, other = i % 2, 1 - i % 2
            raw, shift = coupling(at[other], encoded).unbind(-1)
            log_own = lobes.log_sigma(raw)
            at[own] = at[own] * torch.exp(log_own) + shift
            log_scale = log_scale + log_own
        return (torch.stack(at, -1) - net.mean) * torch.exp(-log_sigma), log_scale

    def from_base(self, net: AffineFlow, condition: Tensor, z: Tensor) -> Tensor:
        """See :meth:`FlowMethod.from_base`."""
        encoded = net.encoder(condition)
        at = list((net.mean + z * torch.exp(lobes.log_sigma(net.raw_sigma))).unbind(-1))
        for i in range(self.couplings - 1, -1, -1):
            own, other = i % 2, 1 - i % 2
            raw, shift = net.couplings[i](at[other], encoded).unbind(-1)
            at[own] = (at[own] - shift) * torch.exp(-lobes.log_sigma(raw))
        return torch.stack(at, -1)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`.

        The density is that of the rounded direction, all the way back to the base: a scale
        of a thousand turns the rounding of ``x`` into a different ``x'``.
        """
        net = self.module
        encoded = net.encoder.encoded(c)
        at = [
            dr.fma(z, dr.exp(type(z)(s)), m)
            for z, m, s in zip(unit_normal_columns(u), *self._base(), strict=True)
        ]
        for i in range(self.couplings - 1, 0, -1):
            own, other = i % 2, 1 - i % 2
            log_own, shift = self._affine(net.couplings[i].columns(at[other], encoded))
            at[own] = (at[own] - shift) * dr.exp(-log_own)
        elsewhere = u[2] < self.uniform
        there = defensive.uniform_disk_columns(u)
        y = dr.select(elsewhere, there[1], at[1])
        log_x, shift = affine = self._affine(net.x_given_y.columns(y, encoded))
        x = dr.select(elsewhere, there[0], (at[0] - shift) * dr.exp(-log_x))
        return x, y, self._density(encoded, affine, x, y)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        encoded = self.module.encoder.encoded(c)
        affine = self._affine(self.module.x_given_y.columns(wo[1], encoded))
        return self._density(encoded, affine, *wo)

    def _density(self, encoded: Encoded, affine: tuple[Float, Float], x: Float, y: Float) -> Float:
        """Density at ``(x, y)``; ``affine`` is the first coupling's log scale and shift."""
        log_scale, shift = affine
        at = [dr.fma(x, dr.exp(log_scale), shift), y]
        for i in range(1, self.couplings):
            own, other = i % 2, 1 - i % 2
            log_own, shift = self._affine(self.module.couplings[i].columns(at[other], encoded))
            at[own] = dr.fma(at[own], dr.exp(log_own), shift)
            log_scale = log_scale + log_own
        (mx, my), (sx, sy) = self._base()
        zx, zy = (at[0] - mx) * dr.exp(type(x)(-sx)), (at[1] - my) * dr.exp(type(y)(-sy))
        log_base = -0.5 * dr.fma(zx, zx, zy * zy) - sx - sy - lobes.LOG_2PI
        return defensive.mixed_columns(dr.exp(log_base + log_scale), [x, y], self.uniform)

    def _base(self) -> tuple[list[float], list[float]]:
        """The base's mean and log sigma."""
        return self.module.mean.tolist(), lobes.log_sigma(self.module.raw_sigma).tolist()

    @staticmethod
    def _affine(raw: Columns) -> tuple[Float, Float]:
        return lobes.log_sigma_columns(raw[0]), raw[1]
