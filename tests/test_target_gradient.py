"""The gradient of a material's target: by torch or Dr.Jit, or refused with the reason."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import Unsupported
from harness.materials import registry as materials
from tests.materials import MATERIALS, HalfBlack, Plain

SHIPPED = "leather"


def rows(material, n: int = 400, seed: int = 0):
    g = torch.Generator().manual_seed(seed)
    return material.conditions(n, g), 0.93 * square_to_disk(torch.rand(n, 2, generator=g))


def differences(material, condition, wo, step: float = 1e-3):
    """Central differences [N, 2] of the target."""
    return torch.stack(
        [
            (material.target(condition, wo + step * e) - material.target(condition, wo - step * e))
            / (2 * step)
            for e in torch.eye(2)
        ],
        -1,
    )


@pytest.mark.parametrize(
    "make",
    [
        *MATERIALS.values(),
        lambda: materials.make("disney"),
        lambda: materials.make("rim-lobe"),
        lambda: materials.make(SHIPPED),
    ],
    ids=[*MATERIALS, "family", "hard", "neural"],
)
def test_it_is_the_derivative(make):
    material = make()
    assert material.why_no_gradient() == ""
    condition, wo = rows(material)
    before = condition.clone(), wo.clone()
    value, slope = material.target_gradient(condition, wo)
    torch.testing.assert_close(value, material.target(condition, wo))
    expected = differences(material, condition, wo)
    # A network bends, and single precision rounds what is subtracted: relative, with a floor.
    error = (slope - expected).norm(dim=1) / (expected.norm(dim=1) + 1e-2 * value.mean())
    assert error.median() < 5e-3 and error.quantile(0.9) < 0.1
    assert torch.equal(condition, before[0]) and torch.equal(wo, before[1])
    assert not value.requires_grad and not slope.requires_grad


def test_none_one_and_inference_mode():
    for material in (Plain(), materials.make("disney")):
        condition, wo = rows(material, 3)
        value, slope = material.target_gradient(condition[:0], wo[:0])
        assert value.shape == (0,) and slope.shape == (0, 2)
        with torch.inference_mode():
            one = material.target_gradient(condition[:1], wo[:1])
        torch.testing.assert_close(one[1], material.target_gradient(condition, wo)[1][:1])


def test_a_step_has_no_slope():
    """Where f is constant in pieces, and where it is zero, its derivative is zero."""
    material = materials.make("black-hemisphere")
    condition, wo = rows(material)
    value, slope = material.target_gradient(condition, wo)
    assert (value > 0).any() and (slope == 0).all() and material.why_no_gradient() == ""
    value, slope = HalfBlack().target_gradient(*rows(HalfBlack()))
    assert (value == 0).any() and (slope[value == 0] == 0).all()


class InNumpy(Plain):
    """Evaluates outside of torch."""

    name = "in-numpy"

    def eval(self, condition, wo):
        return torch.from_numpy(super().eval(condition, wo).detach().numpy() + np.float32(0))


def test_refused_with_the_reason():
    for material, words in (
        (materials.make("ggx-conductor"), "random walks"),
        (InNumpy(), "'in-numpy' gives no gradient of f"),
    ):
        reason = material.why_no_gradient()
        assert words in reason and "\n" not in reason
        with pytest.raises(Unsupported, match="no gradient"):
            material.target_gradient(*rows(material, 2))
