"""The baseline as first published: a Gaussian that stays on the mirror direction."""

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


class FanBaseline(LobeMethod):
    r"""A Lambertian and one isotropic Gaussian lobe whose mean is not predicted.

    After Fan et al. (2022), Neural Layered BRDFs, in the form in which Xu et al. (2023,
    NeuSample, section 3.1) describe it as the baseline that they improve:

    .. math:: p(\omega) = w\,\tfrac{1}{\pi} + (1 - w)\,
              \mathcal{N}(\omega; -\omega_{i,\perp}, \sigma)

    Only the scalar :math:`\sigma` and the weight come from the network. The lobe sits on
    the mirror direction of the *shading* frame, so it misses the highlight wherever the
    material has normals of its own; NeuSample expects it to lose to cosine sampling there.

    The network is that of ``improved-baseline`` (30-32-32-32-3 with eight features), so the
    two differ in the mean alone. Density per disk area; what the Gaussian puts off the disk
    are invalid samples. Uses three uniforms.
    """

    name = "fan-baseline"
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
        """Outputs: log sigma, and the logits of the two weights."""
        net = ConditionalMLP(material, [self.width] * self.layers, 3)
        lobes.start_narrow(net.mlp.layers[-1], slice(0, 1))
        return net

    def lobes(self, condition: Tensor) -> lobes.Lobes:
        """See :meth:`LobeMethod.lobes`."""
        out = self.module(condition)
        sigma = lobes.log_sigma(out[..., :1]).expand(*out.shape[:-1], 2)
        mean = -condition[..., -2:]
        return lobes.Lobes(lobes.log_weight(out[..., 1:]), mean[..., None, :], sigma[..., None, :])

    def lobes_columns(self, c: Columns) -> lobes.ColumnLobes:
        """See :meth:`LobeMethod.lobes_columns`."""
        raw, *logits = self.module.columns(c)
        sigma = lobes.log_sigma_columns(raw)
        return lobes.ColumnLobes(lobes.weight_columns(logits), [(-c[-2], -c[-1])], [(sigma, sigma)])
