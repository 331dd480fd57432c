"""When single precision can follow a flow's samples back to the base."""

from __future__ import annotations

import math
from contextlib import nullcontext

import pytest
import torch

from harness.core import registry
from harness.core.protocol.errors import StateRefused
from harness.fitting.flow_steadiness import steadiness
from harness.nets import domains
from harness.nets.conditional_flow import ConditionalFlow
from harness.nets.discrete_flow import DiscreteFlow
from tests.materials import MATERIALS


def still(radius: float, sigma: float) -> tuple[ConditionalFlow, DiscreteFlow]:
    """A flow of the plane without velocity: a Gaussian at ``radius``, whatever the condition."""
    material = MATERIALS["tilted"]()
    net = ConditionalFlow(material, base="gaussian", domain="plane", width=8, layers=1)
    with torch.no_grad():
        net.base.net.layers[-1].bias[:4] = torch.tensor([radius, 0, *[math.log(sigma)] * 2])
        for parameter in net.velocity.parameters():
            parameter.zero_()
    return net, DiscreteFlow(net.velocity, 1, "euler")


@pytest.mark.parametrize(
    ("radius", "sigma", "movement"),
    [
        (4.0, 0.1, 0.0009),  # 1.7e-4 from the rim
        (4.8, 0.1, 0.025),  # 5e-6 from it, where the domain itself moves by 0.0025
        (0.0, 1.0, 0.0),  # the Lambertian lobe
    ],
)
def test_a_lobe_is_followed_where_rounding_moves_it_little(
    radius: float, sigma: float, movement: float
):
    """Rounding moves a place by 2^-24 / (radius (1 - |wo|)), that is in deviations as said."""
    net, flow = still(radius, sigma)
    if radius:
        rim = math.exp(-(radius**2) / 2) / 2
        assert 2.0**-24 / (radius * rim) / sigma == pytest.approx(movement, rel=0.1)
    found = steadiness(net, flow, MATERIALS["tilted"]())
    assert (found.broken, found.folded, found.at_rim) == (0, 0, 0)
    assert (found.moved > 0.3) == (movement > 1 / 64)


def test_samples_where_the_domain_itself_moves_count_for_themselves():
    """7.7e-8 from the rim."""
    net, flow = still(5.6, 0.1)
    place = torch.tensor([[5.6, 0.0]], dtype=torch.float64)
    assert 1 - domains.to_disk("plane", place).norm() < 1e-7
    found = steadiness(net, flow, MATERIALS["tilted"]())
    assert found.moved < 0.01 and found.at_rim > 0.99


@pytest.mark.parametrize(("radius", "sigma", "refused"), [(5.6, 0.1, True), (0.0, 1.0, False)])
def test_a_state_whose_samples_lie_at_the_rim_is_refused(radius, sigma, refused):
    """And the Lambertian lobe, which has two in a million there, is not."""
    method = registry.make(
        "flow-matching", steps=1, base="gaussian", domain="plane", width=8, layers=1, base_width=32
    )
    method.bind(MATERIALS["tilted"]())
    state = still(radius, sigma)[0].state_dict()
    told = pytest.raises(StateRefused, match="millionth of the rim") if refused else nullcontext()
    with told:
        method.load_state_dict(state)
