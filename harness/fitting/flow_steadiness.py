"""Whether the steps of a fitted flow are one to one, and single precision can follow them."""

from __future__ import annotations

import copy
from typing import NamedTuple

import torch

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.fitting.steady import ROWS, STEADY, UNIT
from harness.nets import domains
from harness.nets.conditional_flow import ConditionalFlow
from harness.nets.discrete_flow import DiscreteFlow, solve


class Steadiness(NamedTuple):
    """Shares of samples: ``broken``, whose direction or density is no number; ``folded``, at which
    a step's determinant is not positive; ``moved``, on the disk, whose base point the rounding of
    the direction moves too far; ``at_rim``, so near to the rim that no state can be followed there,
    where that is more than ``FEW``."""

    broken: float
    folded: float
    moved: float
    at_rim: float


FEW = 0.01
"""Share of the samples that a right state may have within a millionth of the rim, where the uniform
disk has two in a million."""


@torch.no_grad()
def steadiness(net: ConditionalFlow, flow: DiscreteFlow, material: Material) -> Steadiness:
    """Of ``ROWS`` samples, always the same ones, each in a condition of its own; in doubles.

    A fold has samples on its back: a step is proper, so where it covers a place twice, one of the
    origins has a negative determinant, and the share of samples there says how much is folded. The
    movement is what the map's inverse Jacobian makes of the rounding, in deviations of the base,
    and may be no more than ``STEADY``. Where the domain itself moves by that much, within a
    millionth of the rim of ``plane``, no state can be followed, not even the Lambertian lobe: such
    samples do not count, as long as they are ``FEW``.
    """
    net = copy.deepcopy(net).double()
    flow = DiscreteFlow(net.velocity, flow.steps, flow.solver)
    generator = torch.Generator().manual_seed(0)
    device = next(net.parameters()).device
    condition = material.conditions(ROWS, generator, str(device)).double()
    at = net.at(condition)
    reached = flow.forward(net.draw(at.base, 1, generator), at.shared)
    broken = ~(reached.x.isfinite().all(-1) & reached.log_det.isfinite())[:, 0]
    folded = ~broken & (reached.least <= 0)[:, 0]
    wo = net.direction(at, reached.x)
    narrowest = torch.exp(at.base.log_sigma[:, -1:].amin(-1))
    moved, counts = torch.zeros_like(folded), inside_disk(wo[:, 0])
    own, _ = domains.from_disk(net.domain, wo)
    for step in UNIT * torch.eye(2, dtype=wo.dtype, device=device):
        away = net.place(at, wo + step)[0] - reached.x
        back = solve(reached.jacobian, away).abs().amax(-1) / narrowest
        moved |= (back > STEADY)[:, 0]
        of_domain = (domains.from_disk(net.domain, wo + step)[0] - own).abs().amax(-1)
        counts &= (of_domain <= STEADY)[:, 0]
    moved &= counts
    # Of the plane all samples lie on the disk; those of other domains need not.
    rim = ~broken & ~counts if net.domain == "plane" else torch.zeros_like(counts)
    shares = [float(share.double().mean()) for share in (broken, folded, moved, rim)]
    return Steadiness(*shares[:3], shares[3] if shares[3] > FEW else 0.0)
