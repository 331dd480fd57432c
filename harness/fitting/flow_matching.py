r"""Losses of flow matching: straight paths, rectified ones, and the likelihood of the few steps.

*Matching* (Lipman et al. 2023; eq. 3 of PureSample): the velocity at a random time of the straight
path from a base point x0 to a direction x1 drawn from p* is regressed on x1 - x0. *Reflow* (Liu et
al. 2022) does the same on the pairs (x0, x1) of the fitted flow itself, whose paths are straighter.
*Likelihood* maximises the density of the discrete map itself, so that nothing is lost by taking few
steps: this one is ours.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from harness.core.protocol.method import Budget
from harness.fitting.drawn import Drawn
from harness.nets.conditional_flow import ConditionalFlow, Conditioned
from harness.nets.discrete_flow import DiscreteFlow, determinant

TEACHER = 50
"""Euler steps of the flow that pairs are made with: PureSample's own."""
PAIRS = 64
"""Of each condition of the pool."""
ROUNDS = 4
"""Of Newton's method in a fit; a direction that needs more is left out of its batch."""
LEAST = 0.1
"""Determinant of a step below which a fit by likelihood is drawn back: at zero it folds."""
_FOLDS = 100.0
"""Nats per squared unit of a determinant below that."""


def matching_loss(
    net: ConditionalFlow,
    drawn: Drawn,
    budget: Budget,
    generator: torch.Generator,
    pairing: bool,
) -> Tensor:
    """On a batch; with ``pairing`` the base points of a condition go to directions nearby.

    Any one-to-one pairing inside a batch keeps both marginals (Pooladian et al. 2023). A base that
    has a network is fitted to the directions by likelihood, apart: the velocity sees samples of it
    without a gradient.
    """
    condition, wo = drawn.batch(budget.conditions, generator)
    at = net.at(condition)
    x1, log_slope = net.place(at, wo)
    x0 = net.draw(at.base, wo.shape[1], generator).detach()
    apart = (in_rows(x0), in_rows(x1.detach())) if pairing else (x0, x1.detach())
    loss = _regression(net, at, *apart, generator)
    if net.base.net is None:
        return loss
    return loss - net.mixed(at.base.log_prob(x1) + log_slope, wo, at.base).mean()


def in_rows(x: Tensor) -> Tensor:
    """Points [B, D, 2] in order: by x into about sqrt(D) columns, in each of them by y.

    Two sets so ordered are near one another place by place.
    """
    count = x.shape[1]
    column = max(1, math.isqrt(count))
    while count % column:
        column -= 1
    x = x.gather(1, x[..., :1].argsort(1).expand_as(x))
    x = x.unflatten(1, (column, count // column))
    return x.gather(2, x[..., 1:].argsort(2).expand_as(x)).flatten(1, 2)


@dataclass
class Pairs:
    """Base points and where a flow takes them, [P, K, 2] each, in the conditions [P, C]."""

    condition: Tensor
    x0: Tensor
    x1: Tensor

    @classmethod
    @torch.no_grad()
    def of(cls, net: ConditionalFlow, condition: Tensor, generator: torch.Generator) -> Pairs:
        """Of the flow as it is, by ``TEACHER`` Euler steps."""
        teacher = copy.deepcopy(net)
        flow = DiscreteFlow(teacher.velocity, TEACHER)
        x0, x1 = [], []
        for rows in torch.split(condition, 256):
            at = teacher.at(rows)
            x0.append(teacher.draw(at.base, PAIRS, generator))
            x1.append(flow.endpoint(x0[-1], at.shared))
        return cls(condition, torch.cat(x0), torch.cat(x1))

    def loss(self, net: ConditionalFlow, budget: Budget, generator: torch.Generator) -> Tensor:
        """Matching on a batch of the pairs."""
        row = torch.randint(len(self.condition), (budget.conditions,), generator=generator)
        which = torch.randint(PAIRS, (budget.conditions, budget.directions, 1), generator=generator)
        row = row.to(self.condition.device)
        which = which.to(row.device).expand(-1, -1, 2)
        x0, x1 = self.x0[row].gather(1, which), self.x1[row].gather(1, which)
        return _regression(net, net.at(self.condition[row]), x0, x1, generator)


def _regression(
    net: ConditionalFlow,
    at: Conditioned,
    x0: Tensor,
    x1: Tensor,
    generator: torch.Generator,
) -> Tensor:
    """Squared error of the velocity, in units of the base's deviation in each condition."""
    t = torch.rand(*x0.shape[:-1], 1, generator=generator).to(x0.device)
    found = net.velocity(torch.lerp(x0, x1, t), t, at.shared)
    scale = torch.exp(-at.base.log_sigma[:, -1:].detach().mean(-1, keepdim=True))
    return ((found - (x1 - x0)) * scale).square().sum(-1).mean()


def likelihood_loss(
    net: ConditionalFlow,
    steps: int,
    solver: str,
    drawn: Drawn,
    budget: Budget,
    generator: torch.Generator,
) -> Tensor:
    """Negative log likelihood of directions under the map of ``steps`` steps, and its folds.

    A map that folds has no density of the form that is maximised: determinants below ``LEAST``
    are penalised, at samples of the base.
    """
    condition, wo = drawn.batch(budget.conditions, generator)
    flow, at = DiscreteFlow(net.velocity, steps, solver), net.at(condition)
    log_prob, found = net.log_prob(flow, condition, wo, ROUNDS)
    share = found.to(log_prob.dtype).mean()
    loss = -torch.where(found, log_prob, 0).mean() / share.clamp(min=0.5)
    few = max(1, wo.shape[1] // 4)
    x, folds = net.draw(at.base, few, generator).detach(), 0.0
    for k in range(steps):
        x, *tangents = flow.one_dual(x, k, at.shared)
        det = determinant(torch.stack(tangents))
        folds = folds + torch.relu(LEAST - det).square().mean()
        x = x.detach()
    return loss + _FOLDS * folds
