"""The Blinn-Phong adapter against its formula in double precision, sharp and grazing."""

from __future__ import annotations

import math

import pytest
import torch
from scipy import stats
from torch import Tensor

from harness._methods.blinn_phong import BlinnPhong, log1p_columns, log_exponent
from harness.core.protocol.disk import inside_disk
from tests.materials import Plain

EXPONENTS = [0.01, 3.0, 200.0, 1e4, 1e6]
WI = {"normal": (0.0, 0.0), "oblique": (0.6, -0.5), "grazing": (0.0, 0.9999), "rim": (-1.0, 0.0)}


def glossy(exponent: float, logit: float) -> BlinnPhong:
    """The method for a material without features, with the given parameters."""
    method = BlinnPhong()
    method.bind(Plain())
    raw = 14 * math.atanh(math.log(exponent) / 14)
    outputs = torch.tensor([raw, 10 * math.atanh(logit / 10)])
    method.load_state_dict(method.state_dict() | {"constant": outputs})
    return method


def reference(n: float, diffuse: float, wi: Tensor, wo: Tensor) -> Tensor:
    """The density of the docstring in double precision, for points inside the disk."""
    wi, wo = wi.double(), wo.double()
    wi3 = torch.cat([wi, (1 - wi.square().sum(-1, keepdim=True)).clamp(min=0).sqrt()], -1)
    cos = (1 - wo.square().sum(-1)).sqrt()
    half = torch.nn.functional.normalize(wi3 + torch.cat([wo, cos[:, None]], -1), dim=-1)
    lobe = (n + 1) / (2 * math.pi) * half[:, 2] ** n / (4 * (wi3 * half).sum(-1))
    return diffuse / math.pi + (1 - diffuse) * lobe / cos


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
def test_density_is_the_formula(exponent, wi):
    """Both twins match the formula at the method's own samples, and integrate as they should."""
    method = glossy(exponent, 1.0)
    n = 20000
    condition = torch.tensor(wi).expand(n, 2)
    u = torch.rand(n, 3, generator=torch.Generator().manual_seed(3))
    wo, pdf = method.sample(condition, u)
    # Nearer to the rim the rounding of the point itself is all that is compared.
    well = wo.square().sum(-1) < 0.999
    assert well.sum() > n / 10
    expected = reference(exponent, 1 / (1 + math.e), condition[well], wo[well])
    # In a lobe of width w the rounding of a direction moves the density by about eps / w.
    tolerance = 1e-4 + 1e-5 * math.sqrt(exponent)
    torch.testing.assert_close(pdf[well].double(), expected, rtol=tolerance, atol=1e-6)
    with torch.no_grad():
        fit = method.log_prob(condition[:1], wo[well][None])[0].exp()
    torch.testing.assert_close(fit.double(), expected, rtol=tolerance, atol=1e-6)
    assert (pdf[~inside_disk(wo) & (wo[:, 0] == 2)] == 0).all()


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_half_vectors_follow_their_density(exponent):
    """cos^(n+1) of the half vector's angle is uniform, its azimuth too (Kolmogorov-Smirnov)."""
    method = glossy(exponent, 9.9)
    n = 50000
    u = torch.rand(n, 3, generator=torch.Generator().manual_seed(4))
    wo = method.sample(torch.zeros(n, 2), u).wo.double()
    inside = inside_disk(wo)
    wo = wo[inside]
    # At normal incidence wo has twice the half vector's polar angle: valid up to 45 degrees.
    tangent = torch.tan(0.5 * torch.asin(wo.square().sum(-1).sqrt()))
    power = torch.exp(-0.5 * (exponent + 1) * torch.log1p(tangent.square())).numpy()
    least = 0.5 ** (0.5 * (exponent + 1))
    assert abs(inside.double().mean() - (1 - least)) < 5 / math.sqrt(n)
    assert stats.kstest(power, stats.uniform(least, 1 - least).cdf).pvalue > 1e-4
    azimuth = torch.atan2(wo[:, 1], wo[:, 0]).numpy()
    assert stats.kstest(azimuth, stats.uniform(-math.pi, 2 * math.pi).cdf).pvalue > 1e-4


def test_log1p():
    """To single precision over the whole range."""
    from drjit.llvm.ad import Float

    t = torch.cat([torch.zeros(1), torch.logspace(-30, 8, 2000)])
    torch.testing.assert_close(log1p_columns(Float(t)).torch(), t.log1p(), rtol=5e-7, atol=0)


def test_exponent_is_bounded():
    """Any output of the network gives an exponent that single precision can work with."""
    n = log_exponent(torch.tensor([-1e30, -1.0, 0.0, 1e30])).exp()
    assert n.isfinite().all() and (n > 0).all() and n[-1] < 2e6
