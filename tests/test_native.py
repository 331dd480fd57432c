"""The adapter for a material's own sampler."""

from __future__ import annotations

import pytest
import torch

from harness.protocol import Unsupported, cos_theta, inside_disk
from methods.native import Native
from tests.materials import Plain, normal_mapped


def test_material_without_a_sampler():
    """Is unsupported, and the reason names it."""
    able, reason = Native().supports(Plain())
    assert not able and "plain" in reason
    with pytest.raises(Unsupported, match="plain"):
        Native().bind(Plain())


def test_density_is_the_materials_own():
    """Away from the rim it is what the BSDF returns with its samples."""
    from harness.columns import columns_of, tensor_of

    material = normal_mapped()
    method = Native()
    assert method.supports(material) == (True, "")
    method.bind(material)
    n = 20000
    generator = torch.Generator().manual_seed(0)
    condition = material.conditions(n, generator)
    u = torch.rand(n, 3, generator=generator)
    wo, pdf = method.sample(condition, u)
    own = tensor_of(*material.native_sample_columns(columns_of(condition), columns_of(u)), rows=n)
    assert torch.equal(own[:, :2], wo)
    assert (pdf[~inside_disk(wo)] == 0).all()
    well = inside_disk(wo) & (cos_theta(wo) > 0.1)
    assert well.float().mean() > 0.9
    torch.testing.assert_close(pdf[well], own[well, 2], rtol=1e-3, atol=0)
