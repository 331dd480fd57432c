"""The normalizing-flow baseline of NeuSample: two affine couplings, after Xie et al. (2019)."""

from __future__ import annotations

import drjit as dr
import torch
from torch import Tensor, nn

from harness.columns import ColumnMethod, Columns, Float
from harness.fitting import ModuleMethod
from harness.nets import ConditionEncoder, defensive, lobes
from harness.nets.coupling import CouplingNet, unit_normal_columns
from harness.protocol import InputError, Material


class AffineFlow(nn.Module):
    """Two conditioners of two outputs, log scale and shift; the base's mean and log sigma."""

    def __init__(self, material: Material, width: int, frequencies: int, trainable: bool):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features)
        self.x_given_y = CouplingNet(self.encoder.width, width, 2, frequencies)
        self.y_given_x = CouplingNet(self.encoder.width, width, 2, frequencies)
        self.mean = nn.Parameter(torch.zeros(2), requires_grad=trainable)
        self.raw_sigma = nn.Parameter(torch.zeros(2), requires_grad=trainable)


class RealNVP(ModuleMethod, ColumnMethod):
    r"""Two affine couplings: Xie et al. (2019), after Dinh et al. (2016).

    .. math:: x' = x\,e^{s(y)} + t(y), \quad y' = y\,e^{s'(x')} + t'(x'), \quad
              p(\omega) = \mathcal{N}(x', y')\,e^{s(y) + s'(x')}

    The scales and shifts are given by networks of two hidden layers of 32 (LeakyReLU,
    slope 0.01; 39-32-32-2) that see the other coordinate, encoded with four frequencies,
    and the encoded condition. Their last layers start at zero: the flow starts as its base,
    a standard normal. ``base="trainable"`` fits its mean and deviation too, the same for
    all conditions, where the public release offers both.

    The density is per disk area and does not vanish outside: samples there are invalid.
    Log scales are kept within 10 by :func:`harness.nets.lobes.log_sigma`, a deviation from
    the paper that changes nothing where they live. A share ``uniform`` of the samples is
    uniform on the disk (:mod:`harness.nets.defensive`); 0 is the flow as published, whose
    density underflows beside narrow lobes. Uses three uniforms.
    """

    name = "realnvp"
    uniforms = 3
    learning_rate = 1e-2

    def __init__(
        self, width: int = 32, frequencies: int = 4, base: str = "fixed", uniform: float = 0.01
    ):
        if base not in ("fixed", "trainable"):
            raise InputError(f"{self.name}: base is '{base}'; expected 'fixed' or 'trainable'")
        self.width, self.frequencies, self.trainable = width, frequencies, base == "trainable"
        self.uniform = defensive.checked_share(uniform, self.name)

    def build(self, material: Material) -> nn.Module:
        """See :meth:`ModuleMethod.build`."""
        return AffineFlow(material, self.width, self.frequencies, self.trainable)

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D]."""
        net = self.module
        encoded = net.encoder(condition)
        x, y = wo.unbind(-1)
        raw, shift = net.x_given_y(y, encoded).unbind(-1)
        log_x = lobes.log_sigma(raw)
        x = x * torch.exp(log_x) + shift
        raw, shift = net.y_given_x(x, encoded).unbind(-1)
        log_y = lobes.log_sigma(raw)
        y = y * torch.exp(log_y) + shift
        log_sigma = lobes.log_sigma(net.raw_sigma)
        z = (torch.stack([x, y], -1) - net.mean) * torch.exp(-log_sigma)
        flow = -0.5 * z.square().sum(-1) - log_sigma.sum() - lobes.LOG_2PI + log_x + log_y
        return defensive.log_mixed(flow, wo, self.uniform)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`.

        The density is that of the rounded direction, all the way back to the base: a scale
        of a thousand turns the rounding of ``x`` into a different ``x'``.
        """
        encoded = self.module.encoder.columns(c)
        (mx, my), (sx, sy) = self._base()
        zx, zy = unit_normal_columns(u)
        x, y = dr.fma(zx, dr.exp(type(zx)(sx)), mx), dr.fma(zy, dr.exp(type(zy)(sy)), my)
        log_y, shift = self._affine(self.module.y_given_x.columns(x, encoded))
        elsewhere = u[2] < self.uniform
        there = defensive.uniform_disk_columns(u)
        y = dr.select(elsewhere, there[1], (y - shift) * dr.exp(-log_y))
        log_x, shift = affine = self._affine(self.module.x_given_y.columns(y, encoded))
        x = dr.select(elsewhere, there[0], (x - shift) * dr.exp(-log_x))
        return x, y, self._density(encoded, affine, x, y)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        encoded = self.module.encoder.columns(c)
        affine = self._affine(self.module.x_given_y.columns(wo[1], encoded))
        return self._density(encoded, affine, *wo)

    def _density(self, encoded: Columns, affine: tuple[Float, Float], x: Float, y: Float) -> Float:
        """Density at ``(x, y)``; ``affine`` is the first coupling's log scale and shift."""
        log_x, shift = affine
        wo = [x, y]
        x = dr.fma(x, dr.exp(log_x), shift)
        log_y, shift = self._affine(self.module.y_given_x.columns(x, encoded))
        y = dr.fma(y, dr.exp(log_y), shift)
        (mx, my), (sx, sy) = self._base()
        zx, zy = (x - mx) * dr.exp(type(x)(-sx)), (y - my) * dr.exp(type(y)(-sy))
        log_base = -0.5 * dr.fma(zx, zx, zy * zy) - sx - sy - lobes.LOG_2PI
        return defensive.mixed_columns(dr.exp(log_base + log_x + log_y), wo, self.uniform)

    def _base(self) -> tuple[list[float], list[float]]:
        """The base's mean and log sigma."""
        return self.module.mean.tolist(), lobes.log_sigma(self.module.raw_sigma).tolist()

    @staticmethod
    def _affine(raw: Columns) -> tuple[Float, Float]:
        return lobes.log_sigma_columns(raw[0]), raw[1]
