"""The improved baseline of NeuSample: a Lambertian and one isotropic Gaussian lobe."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor, nn

from harness.core.columns.bridge import Columns
from harness.core.protocol.material import Material
from harness.core.protocol.method import Knob
from harness.fitting.lobe_method import LobeMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.nets import lobes
from harness.nets.conditional import ConditionalMLP


class ImprovedBaseline(LobeMethod):
    r"""A Lambertian and an isotropic Gaussian lobe: eq. 1 of Xu et al. (2023), NeuSample.

    .. math:: p(\omega) = w\,\tfrac{1}{\pi} + (1 - w)\,\mathcal{N}(\omega; \mu, \sigma)

    A network (30-32-32-32-5 with eight features, ReLU) predicts the mean :math:`\mu`, one
    standard deviation :math:`\sigma` and the weights from the condition. Density per disk
    area; what falls off the disk is an invalid sample. Uses three uniforms.
    """

    name = "improved-baseline"
    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(self, width: int = 32, layers: int = 3, precision: str = "float32"):
        self.width, self.layers = width, layers
        self.precision = checked_precision(precision, self.name)

    def build(self, material: Material) -> nn.Module:
        """Outputs: mean x, mean y, log sigma, and the logits of the two weights."""
        net = ConditionalMLP(material, [self.width] * self.layers, 5)
        lobes.start_narrow(net.mlp.layers[-1], slice(2, 3))
        return net

    def lobes(self, condition: Tensor) -> lobes.Lobes:
        """See :meth:`LobeMethod.lobes`."""
        out = self.module(condition)
        sigma = lobes.log_sigma(out[..., 2:3]).expand(*out.shape[:-1], 2)
        return lobes.Lobes(lobes.log_weight(out[..., 3:]), out[..., None, :2], sigma[..., None, :])

    def lobes_columns(self, c: Columns) -> lobes.ColumnLobes:
        """See :meth:`LobeMethod.lobes_columns`."""
        mx, my, raw, *logits = self.module.columns(c)
        sigma = lobes.log_sigma_columns(raw)
        return lobes.ColumnLobes(lobes.weight_columns(logits), [(mx, my)], [(sigma, sigma)])
