"""A method whose density is misreported to whoever weighs two strategies by it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.rendering.plugin import SampledBSDF

Factor = Callable[[Any, Any], Any]
"""(wi, wo), local unit vectors -> a positive number: the reported density over the true one."""


class MisreportedBSDF(SampledBSDF):
    r"""As :class:`SampledBSDF`, with a density that is wrong by ``factor`` (> 0) in MIS alone.

    ``sample`` still returns f cos / p with the true p; only ``bs.pdf`` and ``pdf()``, which
    nothing but the weights of multiple importance sampling reads, are c p. The mean stays:
    with the density q of the light's strategy, the two weights

    .. math:: w_b = \frac{(c p)^2}{(c p)^2 + q^2}, \qquad w_l = \frac{q^2}{(c p)^2 + q^2}

    add up to one in every direction, whatever c is there, and each estimator divides by the
    density it was truly drawn from, so the expectation is
    :math:`\int f\,L \cos\theta\,(w_b + w_l)\,d\omega = \int f\,L\cos\theta\,d\omega`. (Where
    p = 0, c p = 0 and the light's strategy has all of it.) Only the variance depends on c.
    Hence a density that MIS alone sees wrongly is invisible in the mean image.
    """

    def __init__(self, material: Material, method: Method, factor: Factor):
        super().__init__(material, method)
        self.factor = factor

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """See :meth:`SampledBSDF.sample`; the value is right, ``bs.pdf`` is not."""
        bs, value = super().sample(ctx, si, sample1, sample2, active)
        bs.pdf *= self.factor(si.wi, bs.wo)
        return bs, value

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """``factor`` times :meth:`SampledBSDF.pdf`, hence also in ``eval_pdf``."""
        return super().pdf(ctx, si, wo, active) * self.factor(si.wi, wo)


def tripled(wi: Any, wo: Any) -> Any:
    """Three times the density, everywhere."""
    return 3.0


def tilted(wi: Any, wo: Any) -> Any:
    """Smooth in the direction: from e^-2 at one horizon to e^2 at the opposite one."""
    return dr.exp(2 * wo.x)
