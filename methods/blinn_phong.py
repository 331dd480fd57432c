"""A Blinn-Phong model fitted per place of the material."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, Knob
from harness.fitting.module_method import ModuleMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.fitting.targets import Targets
from harness.nets.encoding import ConditionEncoder
from harness.nets.extremes import FAR, held
from harness.nets.lobes import log_weight, weight_columns
from harness.nets.mlp import MLP

_LOG_EXPONENT_RANGE = 14.0
_OFF_RIM = 1 - 1e-6


class BlinnPhong(ModuleMethod, ColumnMethod):
    r"""A diffuse and a Blinn-Phong lobe, after Sztrajman et al. (2021).

    With the half vector :math:`h = (\omega_i + \omega) / |\omega_i + \omega|`, per disk area:

    .. math:: p_\perp(\omega) = w\,\frac{1}{\pi} + (1 - w)\,
              \frac{n + 1}{2\pi}\,\frac{\cos^n\theta_h}{4\,(\omega_i \cdot h)\,\cos\theta}

    Glossiness :math:`n` and diffuse share :math:`w` come from the features alone, as Xu et
    al. (2023, NeuSample, section 2) describe it: a network with one hidden layer
    (8-32-2 with eight features), or two plain constants for a material without features.
    Neither normals of the material's own nor a dependence on :math:`\omega_i` can be
    expressed. Sztrajman et al. regress parameters fitted by Ngan et al. (2005); here the
    likelihood of directions drawn from p* is maximised, as for the other lobes.

    Sampling draws ``h`` over the whole hemisphere from its density and reflects ``wi`` about
    it. Where :math:`\omega_i \cdot h \le 0` the reflection is below the horizon, as it is for
    some other ``h`` at oblique ``wi``; those are invalid samples, put at (2, 0) with density 0.
    Every ``wo`` above the horizon has exactly one ``h``, and :math:`\omega_i \cdot h > 0`
    there, so the integral of p over the disk is the share of valid samples. The density grows
    like :math:`1 / \cos\theta` towards the rim, where it is integrable.

    Uses three uniforms: lobe, then elevation and azimuth.
    """

    name = "blinn-phong"
    learning_rate: ClassVar[float] = 2e-2
    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(self, width: int = 32, layers: int = 1, precision: str = "float32"):
        self.width, self.layers = width, layers
        self.precision = checked_precision(precision, self.name)

    def build(self, material: Material) -> nn.Module:
        """Outputs: raw log exponent, and the logit of the glossy share."""
        return LocalNetwork(material, [self.width] * self.layers, 2)

    def loss(self, targets: Targets, budget: Budget, generator: torch.Generator) -> Tensor:
        """See :meth:`ModuleMethod.loss`."""
        condition, wo = targets.batch(budget.conditions, budget.directions, generator)
        # A direction drawn in the outermost cells can round onto the rim itself, which is no
        # direction of the open hemisphere and has no density.
        return -self.log_prob(condition, wo * _OFF_RIM).mean()

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D]; -inf off the disk."""
        raw, logit = self.module(condition)[..., None, :].unbind(-1)
        log_n = log_exponent(raw)
        squared = wo.square().sum(-1)
        inside = squared < 1
        cos = torch.where(inside, 1 - squared, 1).sqrt()
        half = direction(condition[..., None, -2:]) + torch.cat([wo, cos[..., None]], -1)
        xy, z = half[..., :2].square().sum(-1), half[..., 2].square()
        glossy = (
            torch.log1p(log_n.exp())
            - 0.5 * log_n.exp() * torch.log1p(xy / z)
            - 0.5 * torch.log(xy + z)
            - torch.log(cos)
            - math.log(4 * math.pi)
        )
        diffuse, share = log_weight(torch.stack([torch.zeros_like(logit), logit], -1)).unbind(-1)
        mixture = torch.logaddexp(diffuse - math.log(math.pi), share + glossy)
        return torch.where(inside, mixture, -math.inf)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        return self._pdf(*self._parameters(c), direction_columns(*c[-2:]), *wo)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        diffuse, glossy, n = self._parameters(c)
        wi = direction_columns(*c[-2:])
        sin_phi, cos_phi = dr.sincos(2 * math.pi * u[2])
        # cos^(n+1) of the half vector's polar angle is uniform. Its squared sine,
        # 1 - cos^2 = 2 cos sinh(-log cos), stays exact for lobes of any sharpness.
        log_cos = dr.log(1 - u[1]) / (n + 1)
        cos = dr.exp(log_cos)
        sin = dr.sqrt(2 * cos * dr.sinh(-log_cos))
        h = (sin * cos_phi, sin * sin_phi, cos)
        twice = 2 * dr.fma(wi[0], h[0], dr.fma(wi[1], h[1], wi[2] * h[2]))
        x, y, z = (dr.fma(twice, b, -a) for a, b in zip(wi, h, strict=True))
        below = z <= 0
        x, y = dr.select(below, 2, x), dr.select(below, 0, y)
        radius = dr.sqrt(u[1])
        lambertian = u[0] < diffuse
        x = dr.select(lambertian, radius * cos_phi, x)
        y = dr.select(lambertian, radius * sin_phi, y)
        return x, y, self._pdf(diffuse, glossy, n, wi, x, y)

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: exponent and weights at the ends of their range.

        Both weights are equal in ``exponent-to-...``: without weight its lobe would not be seen.
        """
        raw, logit = 0, 1
        state, held = self.state_dict(), self.module.held
        equal = held(state, logit, 0)
        return {
            "exponent-to-0": held(equal, raw, -FAR),
            "exponent-to-infinity": held(equal, raw, FAR),
            "weights-to-0": held(state, logit, -FAR),
            "uniform-to-0": held(state, logit, FAR),
        }

    def _parameters(self, c: Columns) -> tuple[Float, Float, Float]:
        """Diffuse weight, glossy weight, exponent."""
        raw, logit = self.module.columns(c)
        diffuse, glossy = weight_columns([type(logit)(0), logit])
        return diffuse, glossy, dr.exp(log_exponent_columns(raw))

    def _pdf(
        self, diffuse: Float, glossy: Float, n: Float, wi: Columns, x: Float, y: Float
    ) -> Float:
        squared = dr.fma(x, x, y * y)
        inside = squared < 1
        cos = dr.sqrt(dr.select(inside, 1 - squared, 1))
        hx, hy, hz = wi[0] + x, wi[1] + y, wi[2] + cos
        xy, z = dr.fma(hx, hx, hy * hy), hz * hz
        # |wi + wo| is 2 wi.h for unit vectors.
        jacobian = 2 * dr.sqrt(xy + z) * cos
        lobe = (n + 1) / (2 * math.pi) * dr.exp(-0.5 * n * log1p_columns(xy / z)) / jacobian
        return dr.select(inside, dr.fma(glossy, lobe, diffuse * (1 / math.pi)), 0)


class LocalNetwork(nn.Module):
    """A network of the features alone, [..., C] -> [..., outputs]; constants if there are none."""

    def __init__(self, material: Material, hidden: Sequence[int], outputs: int):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features, 0)
        self.n_features = material.n_features
        if self.n_features:
            self.mlp = MLP([self.n_features, *hidden, outputs])
        else:
            self.constant = nn.Parameter(torch.zeros(outputs))

    def forward(self, condition: Tensor) -> Tensor:
        """[..., C] -> [..., outputs]."""
        if self.n_features:
            return self.mlp(self.encoder(condition)[..., : self.n_features])
        return self.constant.expand(*condition.shape[:-1], -1)

    def held(self, state: dict[str, Tensor], output: int, value: float) -> dict[str, Tensor]:
        """A ``state`` of this network in which ``output`` is ``value`` for any features."""
        if self.n_features:
            last = f"mlp.layers.{len(self.mlp.layers) - 1}"
            return held(state, last, slice(output, output + 1), value)
        constant = state["constant"].clone()
        constant[output] = value
        return {**state, "constant": constant}

    def columns(self, c: Columns) -> Columns:
        """The same over columns."""
        if self.n_features:
            return self.mlp.columns(self.encoder.columns(c)[: self.n_features])
        # Opaque: the numbers are data, not part of the kernel.
        return [dr.opaque(type(c[-1]), value) for value in self.constant.tolist()]


def log_exponent(raw: Tensor) -> Tensor:
    """A network's output as log exponent.

    ``14 tanh(raw / 14)`` is the identity where materials are and keeps n between 8e-7
    (half vectors uniform) and 1.2e6 (a lobe one milliradian wide) for any input.
    """
    return _LOG_EXPONENT_RANGE * torch.tanh(raw / _LOG_EXPONENT_RANGE)


def log_exponent_columns(raw: Float) -> Float:
    """:func:`log_exponent` over a column."""
    return _LOG_EXPONENT_RANGE * dr.tanh(raw * (1 / _LOG_EXPONENT_RANGE))


def direction(wi: Tensor) -> Tensor:
    """Unit vectors [..., 3] above ``wi`` [..., 2]; a point beyond the rim is taken as the rim.

    Only rounding puts a ``wi`` there, and its reflections have to stay unit vectors.
    """
    squared = wi.square().sum(-1, keepdim=True)
    xy = wi * squared.clamp(min=1).rsqrt()
    return torch.cat([xy, (1 - squared).clamp(min=0).sqrt()], -1)


def direction_columns(x: Float, y: Float) -> Columns:
    """:func:`direction` over columns."""
    squared = dr.fma(x, x, y * y)
    scale = 1 / dr.sqrt(dr.maximum(squared, 1))
    return [x * scale, y * scale, dr.sqrt(dr.maximum(1 - squared, 0))]


def log1p_columns(t: Float) -> Float:
    """log(1 + t) for t >= 0 without the loss of digits of 1 + t (Kahan's correction)."""
    total = 1 + t
    exact = total == 1
    return dr.select(exact, t, dr.log(total) * t / dr.select(exact, 1, total - 1))
