"""The adapter for a material's own sampler."""

from __future__ import annotations

import pytest
import torch

from harness._methods.native import Native
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import cos_theta, inside_disk
from harness.core.protocol.errors import Unsupported
from harness.materials import registry as materials
from tests.materials import Plain, normal_mapped


def test_material_without_a_sampler():
    """Is unsupported, and the reason names it."""
    able, reason = Native().supports(Plain())
    assert not able and "plain" in reason
    with pytest.raises(Unsupported, match="plain"):
        Native().bind(Plain())


def test_density_is_the_materials_own():
    """Away from the rim it is what the BSDF returns with its samples."""
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
    seen = pdf > 0
    assert torch.equal(own[seen, :2], wo[seen])
    # What rounding took over the horizon of the bent normal is no sample; that is rare.
    lost = inside_disk(own[:, :2]) & ~seen
    assert lost.float().mean() < 1e-3 and not inside_disk(wo[lost]).any()
    assert (pdf[~inside_disk(wo)] == 0).all()
    well = inside_disk(wo) & (cos_theta(wo) > 0.1)
    assert well.float().mean() > 0.9
    torch.testing.assert_close(pdf[well], own[well, 2], rtol=1e-3, atol=0)


def test_a_direction_rounded_over_a_bent_normal_s_horizon_is_no_sample():
    """Suede's sampler gives one of positive density; its rounded point has none, and no f."""
    material, method = materials.make("suede"), Native()
    method.bind(material)
    place = [0.07074076, 0.8705965, 0.2285769, 0.09558479, 0.03538359, 0.5190843, 0.4647642, 0.9956]
    condition = torch.tensor([[*place, -0.7373937, 0.6754632]]).expand(1025, -1).clone()
    u = torch.rand(1025, 3, generator=torch.Generator().manual_seed(0))
    u[0] = torch.tensor([0.9293134, 0.02925038, 0.2148275])
    x, y, reported = material.native_sample_columns(columns_of(condition), columns_of(u))
    theirs = tensor_of(x, y, rows=len(u))
    assert reported.numpy()[0] > 0 and inside_disk(theirs)[0]
    assert (
        method.pdf(condition, theirs)[0] == 0 and (material.eval(condition, theirs)[0] == 0).all()
    )
    wo, pdf = method.sample(condition, u)
    assert pdf[0] == 0 and not inside_disk(wo)[0]
    # All others are the material's own.
    seen = pdf > 0
    assert seen.sum() > 900 and torch.equal(wo[seen], theirs[seen])
    assert torch.equal(pdf, method.pdf(condition, wo))
