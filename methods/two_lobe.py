"""NeuSample's analytic mixture: a Lambertian and two axis-aligned Gaussian lobes."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor, nn

from harness.core.columns.bridge import Columns
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Knob
from harness.fitting.lobe_method import LobeMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.nets import lobes
from harness.nets.conditional import ConditionalMLP


class TwoLobe(LobeMethod):
    r"""A Lambertian and two axis-aligned Gaussian lobes: eq. 2 of Xu et al. (2023), NeuSample.

    .. math:: p(\omega) = w_1\,\tfrac{1}{\pi} + w_2\,G_d(\omega; \mu_1, \sigma_1)
              + w_3\,G_d(\omega; \mu_2, \sigma_2)

    :math:`G_d` is a normalised Gaussian on the projected disk with its own standard
    deviation along x and along y. A network with one hidden layer (30-32-11 with eight
    features) predicts both means, the four log standard deviations and three logits from
    the condition. Density per disk area; the Gaussians reach beyond the disk, and what falls
    there is an invalid sample. Uses three uniforms.

    ``lobes`` is how many Gaussians there are, L; the paper has two. The network then has
    2 L means, 2 L log standard deviations and 1 + L logits, in this order.

    Differs from the public release in that log sigma is bounded smoothly
    (:func:`harness.nets.lobes.log_sigma`), where the release takes it as it comes.
    """

    name = "two-lobe"
    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("lobes", (1, 2, 3, 4, 8), "Gaussian lobes beside the Lambertian one"),
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self, width: int = 32, layers: int = 1, lobes: int = 2, precision: str = "float32"
    ):
        if lobes < 1:
            raise InputError(f"{self.name}: lobes is {lobes}; expected at least 1")
        self.width, self.layers, self.count = width, layers, lobes
        self.precision = checked_precision(precision, self.name)

    def build(self, material: Material) -> nn.Module:
        """Outputs: means (x, y) of all lobes, log sigmas (x, y) of all, logits."""
        n = self.count
        net = ConditionalMLP(material, [self.width] * self.layers, 5 * n + 1)
        lobes.start_narrow(net.mlp.layers[-1], slice(2 * n, 4 * n))
        return net

    def lobes(self, condition: Tensor) -> lobes.Lobes:
        """See :meth:`LobeMethod.lobes`."""
        n, out = self.count, self.module(condition)
        mean = out[..., : 2 * n].unflatten(-1, (n, 2))
        sigma = lobes.log_sigma(out[..., 2 * n : 4 * n]).unflatten(-1, (n, 2))
        return lobes.Lobes(lobes.log_weight(out[..., 4 * n :]), mean, sigma)

    def lobes_columns(self, c: Columns) -> lobes.ColumnLobes:
        """See :meth:`LobeMethod.lobes_columns`."""
        n, out = self.count, self.module.columns(c)
        mean, sigma = out[: 2 * n], [lobes.log_sigma_columns(r) for r in out[2 * n : 4 * n]]
        return lobes.ColumnLobes(
            lobes.weight_columns(out[4 * n :]),
            list(zip(mean[0::2], mean[1::2], strict=True)),
            list(zip(sigma[0::2], sigma[1::2], strict=True)),
        )
