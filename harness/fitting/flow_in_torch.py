"""Flow matching as an ordinary torch module runs it: the twin that columns are timed beside."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from harness.core.protocol.method import DiskSample, Method
from harness.fitting.module_method import ModuleMethod
from harness.nets.conditional_flow import ConditionalFlow
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.mlp import split_rows

CHUNK = 16_384
"""Rows whose activations stay in a CPU's cache."""


class FlowInTorch(Method):
    """The same samples and densities as ``method``, a fitted flow, by torch in chunks of rows."""

    def __init__(self, method: ModuleMethod, flow: DiscreteFlow):
        self.name = f"{method.name} in torch"
        self.method, self.flow, self.material = method, flow, method.material

    @torch.inference_mode()
    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        net = self.method.module
        parts = [
            _sample(net, self.flow, c, v)
            for c, v in zip(split_rows(condition, CHUNK), split_rows(u, CHUNK), strict=True)
        ]
        return DiskSample(*(torch.cat(part) for part in zip(*parts, strict=True)))

    @torch.inference_mode()
    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        pairs = zip(split_rows(condition, CHUNK), split_rows(wo, CHUNK), strict=True)
        return torch.cat([self.method.log_prob(c, o[:, None])[:, 0].exp() for c, o in pairs])

    def state_dict(self) -> dict[str, Tensor]:
        """See :meth:`Method.state_dict`."""
        return self.method.state_dict()


def _sample(
    net: ConditionalFlow, flow: DiscreteFlow, condition: Tensor, u: Tensor
) -> tuple[Tensor, Tensor]:
    """Directions [N, 2] and densities [N]."""
    at = net.at(condition)
    turn = 2 * math.pi * u[:, 1]
    circle = torch.stack([turn.cos(), turn.sin()], -1)
    share = net.outer_share(at.base)
    elsewhere = u[:, 2] < share
    pick = (u[:, 2] - share) / (1 - share)
    z = (-2 * torch.log1p(-u[:, :1])).sqrt() * circle
    x0 = at.base.place(z[:, None], pick[:, None])
    moved = flow.forward(x0, at.shared)
    wo = net.direction(at, moved.x)
    wo = torch.where(elsewhere[:, None, None], (u[:, :1].sqrt() * circle)[:, None], wo)
    place, log_slope = net.place(at, wo)
    log_prob = at.base.log_prob(x0) - moved.log_det + log_slope
    if bool(elsewhere.any()):
        some = elsewhere.nonzero()[:, 0]
        origin = flow.invert(place[some], at.shared[some])
        density = at.base.rows(some).log_prob(origin.x) - origin.log_det
        log_prob[some] = density + log_slope[some]
    return wo[:, 0], net.mixed(log_prob, wo, at.base)[:, 0].exp()
