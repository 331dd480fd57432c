"""The baselines of NeuSample: a Lambertian and one isotropic Gaussian lobe."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor, nn

from harness.core.columns.bridge import Columns
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.core.protocol.method import Knob
from harness.fitting.lobe_method import LobeMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.nets import lobes
from harness.nets.conditional import ConditionalMLP

MEANS = ("predicted", "mirror")


class ImprovedBaseline(LobeMethod):
    r"""A Lambertian and an isotropic Gaussian lobe: eq. 1 of Xu et al. (2023), NeuSample.

    .. math:: p(\omega) = w\,\tfrac{1}{\pi} + (1 - w)\,\mathcal{N}(\omega; \mu, \sigma)

    A network (30-32-32-32-5 with eight features, ReLU) predicts the mean :math:`\mu`, one
    standard deviation :math:`\sigma` and the weights from the condition. Density per disk
    area; what falls off the disk is an invalid sample. Uses three uniforms.

    ``mean``: ``"predicted"``, or ``"mirror"`` for the form of Fan et al. (2022), Neural Layered
    BRDFs, that NeuSample (section 3.1) improves on. There :math:`\mu = -\omega_{i,\perp}`, the
    mirror direction of the shading frame, and the network has three outputs. The lobe then misses
    the highlight wherever the material has normals of its own. ``fan-baseline`` is that form.
    """

    name = "improved-baseline"
    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self, width: int = 32, layers: int = 3, precision: str = "float32", mean: str = "predicted"
    ):
        if mean not in MEANS:
            known = " or ".join(MEANS)
            raise InputError(f"{self.name}: mean: expected {known}, got {mean!r}"
                             f"{nearest(str(mean), MEANS)}")  # fmt: skip
        self.width, self.layers = width, layers
        self.precision = checked_precision(precision, self.name)
        self.mean = mean

    def build(self, material: Material) -> nn.Module:
        """Outputs: mean x, mean y (if predicted), log sigma, and the logits of the two weights."""
        first = self._means
        net = ConditionalMLP(material, [self.width] * self.layers, first + 3)
        lobes.start_narrow(net.mlp.layers[-1], slice(first, first + 1))
        return net

    def lobes(self, condition: Tensor) -> lobes.Lobes:
        """See :meth:`LobeMethod.lobes`."""
        out, first = self.module(condition), self._means
        mean = out[..., :2] if first else -condition[..., -2:]
        sigma = lobes.log_sigma(out[..., first : first + 1]).expand(*out.shape[:-1], 2)
        weight = lobes.log_weight(out[..., first + 1 :])
        return lobes.Lobes(weight, mean[..., None, :], sigma[..., None, :])

    def lobes_columns(self, c: Columns) -> lobes.ColumnLobes:
        """See :meth:`LobeMethod.lobes_columns`."""
        out, first = self.module.columns(c), self._means
        mean = (out[0], out[1]) if first else (-c[-2], -c[-1])
        sigma = lobes.log_sigma_columns(out[first])
        weight = lobes.weight_columns(out[first + 1 :])
        return lobes.ColumnLobes(weight, [mean], [(sigma, sigma)])

    @property
    def _means(self) -> int:
        """How many outputs of the network are coordinates of the mean."""
        return 2 if self.mean == "predicted" else 0


class FanBaseline(ImprovedBaseline):
    """The baseline of Fan et al. (2022): ``improved-baseline`` with ``mean: mirror``.

    NeuSample expects it to lose to cosine sampling where a material has normals of its own.
    """

    name = "fan-baseline"

    def __init__(self, width: int = 32, layers: int = 3, precision: str = "float32"):
        super().__init__(width, layers, precision, mean="mirror")
