"""Flow matching with the pdf as published: the flow run backwards by explicit steps. **Biased**."""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
from torch import Tensor

from harness._methods.flow_matching import FlowMatching
from harness.core.columns.bridge import Columns, Float
from harness.core.columns.reflectance import reflectance_columns
from harness.nets import discrete_flow_columns, flow_sampling
from harness.nets.conditional_flow import ConditionalFlow
from harness.nets.coupling import unit_normal_columns
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.velocity import Shared


class FlowMatchingPublished(FlowMatching):
    r"""PureSample, section 5.1, and Fu et al. (2024): steps back with the velocity of their end.

    .. math:: x_k = x_{k+1} - \tfrac{1}{S}\,u(x_{k+1}, \tfrac{k+1}{S}), \qquad
              q(\omega) = p_0(x_0) \prod_k
              \left|\det \frac{\partial x_k}{\partial x_{k+1}}\right|

    Networks, fits and samples are those of ``flow-matching``. The steps back are not the inverse
    of the steps of sampling: q is the density of no sampler, its integral is not one, and its
    error is of the order of 1 / S. **Biased**: estimates are f / q. Newton's method is saved, so
    that a query costs as much as a sample. ``exact_pdf`` is false.
    """

    name = "flow-matching-published"
    exact_pdf = False
    accumulated: ClassVar[bool] = False
    """Whether estimates are f over the exact density, that sampling accumulates on its way."""

    def sample_weighted_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float, Any]:
        """See :meth:`ColumnMethod.sample_weighted_columns`."""
        x, y, pdf = self.sample_columns(c, u)
        f = reflectance_columns(self.material, c, [x, y])
        # Off the disk there is nothing to be seen, whatever the density says of it.
        inside = dr.fma(x, x, y * y) < 1
        return x, y, pdf, [dr.select(inside, v / pdf, 0) for v in f]

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`; the density is q, or the exact one."""
        if self.accumulated:
            return super().sample_columns(c, u)
        net, flow = self.module, self.flow()
        at = net.at_columns(c)
        elsewhere, pick = flow_sampling.outside(net, at.base, u)
        x0 = at.base.place(unit_normal_columns(u), pick)
        end = discrete_flow_columns.endpoint(flow, x0, at.shared)
        wo = flow_sampling.directions(net, at, end, elsewhere, u)
        return *wo, self._density(at, wo)

    def back(self, flow: DiscreteFlow, place: Columns, shared: Shared) -> Any:
        """See :meth:`FlowMatching.back`: by explicit steps."""
        return discrete_flow_columns.backward(flow, place, shared)

    def _log_prob(self, net: ConditionalFlow, condition: Tensor, wo: Tensor) -> Tensor:
        at = net.at(condition)
        place, log_slope = net.place(at, wo)
        origin = self.flow(net).backward(place, at.shared)
        log_prob = at.base.log_prob(origin.x) - origin.log_det + log_slope
        return net.mixed(log_prob, wo, at.base)

    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.inverse`: none that the published pdf knows."""
        return None


class FlowMatchingPublishedQuery(FlowMatchingPublished):
    """Exact where it samples, published where it is asked: as the release of Fu et al. renders.

    Estimates are f over the density that the samples' own steps accumulate: without bias. Only the
    densities of other directions are q, and bias multiple importance sampling: the light samples'
    weights and the BSDF samples' do not sum to one. **Biased** with light sampling alone.
    """

    name = "flow-matching-published-query"
    accumulated = True
