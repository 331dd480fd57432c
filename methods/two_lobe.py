"""NeuSample's analytic mixture: a Lambertian and two axis-aligned Gaussian lobes."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from harness.columns import Columns
from harness.fitting import LobeMethod
from harness.nets import ConditionalMLP, lobes
from harness.protocol import Material


class TwoLobe(LobeMethod):
    r"""A Lambertian and two axis-aligned Gaussian lobes: eq. 2 of Xu et al. (2023), NeuSample.

    .. math:: p(\omega) = w_1\,\tfrac{1}{\pi} + w_2\,G_d(\omega; \mu_1, \sigma_1)
              + w_3\,G_d(\omega; \mu_2, \sigma_2)

    :math:`G_d` is a normalised Gaussian on the projected disk with its own standard
    deviation along x and along y. A network with one hidden layer (30-32-11 with eight
    features) predicts both means, the four log standard deviations and three logits from
    the condition. Density per disk area; the Gaussians reach beyond the disk, and what falls
    there is an invalid sample. Uses three uniforms.

    Differs from the public release in that log sigma is bounded smoothly
    (:func:`harness.nets.lobes.log_sigma`), where the release takes it as it comes.
    """

    name = "two-lobe"

    def __init__(self, width: int = 32, layers: int = 1):
        self.width, self.layers = width, layers

    def build(self, material: Material) -> nn.Module:
        """Outputs: mean (x, y) of both lobes, log sigma (x, y) of both, three logits."""
        net = ConditionalMLP(material, [self.width] * self.layers, 11)
        lobes.start_narrow(net.mlp.layers[-1], slice(4, 8))
        return net

    def lobes(self, condition: Tensor) -> lobes.Lobes:
        """See :meth:`LobeMethod.lobes`."""
        out = self.module(condition)
        mean = out[..., 0:4].unflatten(-1, (2, 2))
        sigma = lobes.log_sigma(out[..., 4:8]).unflatten(-1, (2, 2))
        return lobes.Lobes(torch.log_softmax(out[..., 8:], -1), mean, sigma)

    def lobes_columns(self, c: Columns) -> lobes.ColumnLobes:
        """See :meth:`LobeMethod.lobes_columns`."""
        out = self.module.columns(c)
        s = [lobes.log_sigma_columns(raw) for raw in out[4:8]]
        return lobes.ColumnLobes(
            lobes.softmax_columns(out[8:]),
            [(out[0], out[1]), (out[2], out[3])],
            [(s[0], s[1]), (s[2], s[3])],
        )
