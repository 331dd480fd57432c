"""The normalizing flow of NeuSample: two spline couplings over a conditional Gaussian."""

from __future__ import annotations

import drjit as dr
import torch
from torch import Tensor, nn

from harness.columns import ColumnMethod, Columns, Float
from harness.fitting import ModuleMethod
from harness.nets import MLP, ConditionEncoder, defensive, lobes, spline
from harness.nets.coupling import CouplingNet, unit_normal_columns
from harness.protocol import InputError, Material

_START = -0.7
"""Log sigma of the base before fitting: half the disk's radius, broad but mostly inside."""


class SplineFlow(nn.Module):
    """The networks: condition -> base Gaussian; other coordinate and condition -> spline.

    Last layers start at zero: every condition starts with identity splines over one
    broad Gaussian.
    """

    def __init__(self, material: Material, width: int, bins: int, frequencies: int):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features)
        encoded, numbers = self.encoder.width, spline.outputs(bins)
        self.base = MLP([encoded, width, 4], "leaky_relu", zero_last=True)
        with torch.no_grad():
            self.base.layers[-1].bias[2:] = _START
        self.x_given_y = CouplingNet(encoded, width, numbers, frequencies)
        self.y_given_x = CouplingNet(encoded, width, numbers, frequencies)


class NeuralSplineFlow(ModuleMethod, ColumnMethod):
    r"""Two rational-quadratic spline couplings: eqs. 3-4 of Xu et al. (2023), NeuSample.

    .. math:: x' = f(x \mid y), \quad y' = g(y \mid x'), \qquad
              p(\omega) = \mathcal{N}(x', y';\,\mu, \sigma)\,
              \frac{\partial f}{\partial x}\,\frac{\partial g}{\partial y}

    f and g are rational-quadratic splines (Durkan et al. 2019) of K = 20 bins on [-1, 1] with the
    identity beyond (:mod:`harness.nets.spline`), their 59 numbers given by networks
    39-32-32-59 of the other coordinate (encoded with four frequencies) and the encoded
    condition. A network 30-32-4 of the condition gives the diagonal Gaussian's mean and log
    sigma. LeakyReLU of slope 0.01 throughout. Two uniforms make the Gaussian's sample,
    which is taken through the inverses: y, then x.

    ``domain="disk"`` is the paper's: the splines act on the projected disk's own
    coordinates. ``domain="square"`` has them act on :math:`(x / \sqrt{1 - y^2},\, y)`, which
    makes the disk a square whose edges the splines need not find; the density is divided by
    the chord :math:`\sqrt{1 - y^2}` (by 1 where |y| >= 1, off the disk). In either, what the
    Gaussian puts beyond [-1, 1] passes as it is and becomes an invalid sample.

    A share ``uniform`` of the samples is uniform on the disk (:mod:`harness.nets.defensive`);
    0 is the flow as published. The last network runs again at the rounded sample, so that its
    density is bit for bit the one :meth:`pdf` gives.

    Deviations from the public release: log sigma and derivatives are bounded smoothly
    instead of left free, last layers start at zero, and the step size is larger, without
    which short fits end far from their plateau.
    """

    name = "neural-spline-flow"
    uniforms = 3
    learning_rate = 1e-2

    def __init__(
        self,
        width: int = 32,
        bins: int = 20,
        frequencies: int = 4,
        domain: str = "disk",
        uniform: float = 0.01,
    ):
        if not 2 <= bins < 500:
            raise InputError(f"{self.name}: bins is {bins}; expected 2 to 499")
        if domain not in ("disk", "square"):
            raise InputError(f"{self.name}: domain is '{domain}'; expected 'disk' or 'square'")
        self.width, self.bins, self.frequencies = width, bins, frequencies
        self.square = domain == "square"
        self.uniform = defensive.checked_share(uniform, self.name)

    def build(self, material: Material) -> nn.Module:
        """See :meth:`ModuleMethod.build`."""
        return SplineFlow(material, self.width, self.bins, self.frequencies)

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D]."""
        net = self.module
        encoded = net.encoder(condition)
        mean, raw = net.base(encoded)[:, None].chunk(2, -1)
        log_sigma = lobes.log_sigma(raw)
        x, y = wo.unbind(-1)
        log_chord = torch.zeros_like(y)
        if self.square:
            squared = (1 - y) * (1 + y)
            log_chord = 0.5 * torch.where(squared > 0, squared, 1).log()
            x = x * torch.exp(-log_chord)
        x, log_x = spline.warp(net.x_given_y(y, encoded), x)
        y, log_y = spline.warp(net.y_given_x(x, encoded), y)
        z = (torch.stack([x, y], -1) - mean) * torch.exp(-log_sigma)
        base = -0.5 * z.square().sum(-1) - log_sigma.sum(-1) - lobes.LOG_2PI
        return defensive.log_mixed(base + log_x + log_y - log_chord, wo, self.uniform)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        net = self.module
        encoded = net.encoder.columns(c)
        mean, log_sigma = base = self._base(encoded)
        elsewhere = u[2] < self.uniform
        there = defensive.uniform_disk_columns(u)
        x, y = (
            dr.fma(z, dr.exp(s), m)
            for z, s, m in zip(unit_normal_columns(u), log_sigma, mean, strict=True)
        )
        y, _ = spline.unwarp_columns(net.y_given_x.columns(x, encoded), y)
        y = dr.select(elsewhere, there[1], y)
        numbers = net.x_given_y.columns(y, encoded)
        x, _ = spline.unwarp_columns(numbers, x)
        chord = self._chord(y)
        wo = [dr.select(elsewhere, there[0], x * chord), y]
        return *wo, self._density(encoded, base, numbers, chord, wo)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        encoded = self.module.encoder.columns(c)
        numbers = self.module.x_given_y.columns(wo[1], encoded)
        return self._density(encoded, self._base(encoded), numbers, self._chord(wo[1]), wo)

    def _chord(self, y: Float) -> Float:
        """What x is divided by: half the disk's width at ``y``, or one."""
        if not self.square:
            return type(y)(1)
        squared = (1 - y) * (1 + y)
        return dr.sqrt(dr.select(squared > 0, squared, 1))

    def _base(self, encoded: Columns) -> tuple[Columns, Columns]:
        """The Gaussian's mean and log sigma."""
        out = self.module.base.columns(encoded)
        return out[:2], [lobes.log_sigma_columns(raw) for raw in out[2:]]

    def _density(
        self,
        encoded: Columns,
        base: tuple[Columns, Columns],
        numbers: Columns,
        chord: Float,
        wo: Columns,
    ) -> Float:
        """Density at ``wo``; ``numbers`` are the first spline's, which depend on y alone."""
        x, slope_x = spline.warp_columns(numbers, wo[0] / chord)
        y, slope_y = spline.warp_columns(self.module.y_given_x.columns(x, encoded), wo[1])
        (mx, my), (sx, sy) = base
        zx, zy = (x - mx) * dr.exp(-sx), (y - my) * dr.exp(-sy)
        normal = dr.exp(-0.5 * dr.fma(zx, zx, zy * zy) - sx - sy - lobes.LOG_2PI)
        return defensive.mixed_columns(normal * (slope_x * slope_y / chord), wo, self.uniform)
