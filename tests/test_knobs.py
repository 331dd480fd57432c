"""Accuracy knobs: what adapters declare, the parameters behind it, and sweeps in suites."""

from __future__ import annotations

import inspect
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from harness import Budget
from harness.core import registry
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.method import Knob
from harness.nets.coupling import uniforms_of_normal, unit_normal_columns
from harness.nets.encoding import sinusoids, sinusoids_columns
from harness.stats.chisquare import sidak
from tests.disk import compare
from tests.materials import MATERIALS

UNFITTED = {
    *("cosine", "native", "random-walk", "tabulated"),
    *("flow-matching-fu2024", "puresample"),
}
WITHOUT = {"cosine", "native", "random-walk", "puresample"}
BUDGET = Budget(steps=12, conditions=64, directions=32, resolution=32, pool=256)
TILTED = MATERIALS["tilted"]()


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def fitted(name: str, budget: Budget = BUDGET, **params: Any):
    method = registry.make(name, **params)
    method.fit(TILTED, budget, generator())
    return method


# --- declarations ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", registry.names())
def test_declared_knobs_exist(name):
    """Every knob is a parameter or part of the budget, and its values contain the default."""
    loaded = registry.load(name)
    parameters = inspect.signature(loaded).parameters
    assert bool(loaded.knobs) == (name not in WITHOUT)
    names = [knob.name for knob in loaded.knobs]
    assert len(set(names)) == len(names)
    for knob in loaded.knobs:
        assert len(set(knob.values)) == len(knob.values) > 1 and knob.about
        if knob.name.startswith("budget."):
            default = getattr(Budget(), knob.name.removeprefix("budget."))
        else:
            default = parameters[knob.name].default
        assert default in knob.values
        if not isinstance(default, str):
            assert list(knob.values) == sorted(knob.values)
    if name not in UNFITTED:
        assert {"budget.steps", "precision"} <= set(names) or not loaded.exact_pdf


SMALL = {
    "histogram-mixture": {"levels": 10, "resolution": 16},
    "importance-baked": {"resolution": 8, "slices": 16},
    "flow-matching": {"width": 16, "layers": 2, "steps": 4},
}
"""What makes a method quick where it is not the size that is tested."""
STRUCTURE = ("couplings", "lobes", "bins", "bases", "levels")
"""Knobs that change what is computed, and not only how large its matrices are."""
ENDS = [
    (name, knob.name, knob.values[end])
    for name in registry.names()
    if registry.load(name).exact_pdf
    for knob in registry.load(name).knobs
    for end in (0, -1)
    # A table of 2048 cells a side for every row is for the check of the adapter, not here.
    if not knob.name.startswith("budget.") and knob.values[end] not in ("float32", 2048)
]
SLOW_KNOBS = [
    e
    for e in ENDS
    if e[1] not in STRUCTURE
    or e[0] == "importance-baked"
    or (e[0] == "histogram-mixture" and e[2] in (20, 300))
]


@pytest.mark.parametrize(
    ("name", "knob", "value"),
    [pytest.param(*e, marks=pytest.mark.slow if e in SLOW_KNOBS else ()) for e in ENDS],
)
def test_every_setting_is_a_correct_sampler(name, knob, value):
    """At both ends of every knob samples follow the pdf, and it integrates to the valid share."""
    method = fitted(name, BUDGET, **{**SMALL.get(name, {}), knob: value})
    row = TILTED.conditions(1, generator(1))[0]
    n = 1 << 15
    test, integral, valid = compare(method, row, n, generator(2))
    assert abs(integral - valid) < 1e-3 + 5 * math.sqrt(valid * (1 - valid) / n)
    assert test.p_value > sidak(1e-3, len(ENDS))
    condition, u = TILTED.conditions(256, generator(3)), torch.rand(256, 3, generator=generator(4))
    wo, pdf = method.sample(condition, u)
    torch.testing.assert_close(method.pdf(condition, wo), pdf, rtol=1e-4, atol=0)
    if hasattr(method, "log_prob") and not name.startswith("histogram"):
        with torch.no_grad():
            log = method.log_prob(condition, wo[:, None])[:, 0]
        torch.testing.assert_close(log.exp(), pdf, rtol=1e-3, atol=1e-5)


def test_declared_in_an_adapter_of_the_suites_own(tmp_path: Path):
    """A declaration is all it takes."""
    file = tmp_path / "own.py"
    file.write_text(ADAPTER)
    assert registry.load(f"{file}:Own").knobs == (Knob("sigma", (0.4, 0.2), "width"),)


ADAPTER = """
from harness import DiskSample, Method
from harness import Knob


class Own(Method):
    '''An adapter.'''

    name = "own"
    knobs = (Knob("sigma", (0.4, 0.2), "width"),)

    def __init__(self, sigma: float = 0.2):
        self.sigma = sigma

    def sample(self, condition, u):
        return DiskSample(u[:, :2] * 0, self.pdf(condition, u[:, :2]))

    def pdf(self, condition, wo):
        return wo[:, 0] * 0 + 1
"""
# --- the new parameters ------------------------------------------------------------------------

FLOWS = [
    (name, {"couplings": n, **more})
    for name, more in (
        ("realnvp", {}),
        ("neural-spline-flow", {"bins": 6}),
    )
    for n in (1, 2, 3)
] + [("neural-spline-flow", {"bins": 6, "domain": "square"})]
flows = pytest.mark.parametrize(("name", "params"), FLOWS)


@flows
def test_inverse_gives_back_the_sample(name, params):
    """``sample`` after ``inverse`` is where it was, and ``inverse`` after ``sample`` too."""
    method = fitted(name, **params)
    condition, u = (
        TILTED.conditions(4000, generator(5)),
        torch.rand(4000, 3, generator=generator(6)),
    )
    u[:, 2] = method.uniform + (1 - method.uniform) * u[:, 2]
    wo = method.sample(condition, u).wo
    found = method.inverse(condition, wo)
    assert found.dtype == torch.float64 and ((found >= 0) & (found < 1)).all()
    assert (found[:, 2] >= method.uniform).all()
    again = method.sample(condition, found.float()).wo
    # A uniform is known to 6e-8; the map stretches that by one over its density.
    assert (again - wo).abs().quantile(0.99) < 2e-4
    turn = (found[:, 1] - u[:, 1] + 0.5).remainder(1) - 0.5
    away = u[:, 0] > 1e-3  # at the centre of the Gaussian the angle is lost
    assert turn[away].abs().quantile(0.99) < 1e-3
    assert (found[:, 0] - u[:, 0]).abs().quantile(0.99) < 1e-3


def test_uniforms_of_normals_are_the_inverse_of_box_and_muller():
    u = torch.rand(10_000, 2, generator=generator(), dtype=torch.float64).clamp(1e-6)
    columns = columns_of(u.float())
    z = tensor_of(*unit_normal_columns(columns), rows=len(u)).double()
    torch.testing.assert_close(uniforms_of_normal(z), u, rtol=0, atol=5e-6)
    # The quadrants by hand, and what lies beyond every sample.
    hand = torch.tensor([[1.0, 0], [0, 1], [-1, 0], [0, -1], [0, 0], [40, 0]], dtype=torch.float64)
    found = uniforms_of_normal(hand)
    assert found[:4, 1].tolist() == [0, 0.25, 0.5, 0.75]
    torch.testing.assert_close(found[:4, 0], torch.full((4,), 1 - math.exp(-0.5)).double())
    assert found[4, 0] == 0 and found[5, 0] == 1 - 2**-24


@pytest.mark.parametrize("name", ["realnvp", "neural-spline-flow"])
def test_far_off_the_disk_is_a_density(name):
    """At any finite direction that an invalid sample can have; encodings stay bounded there."""
    method = fitted(name)
    at = torch.tensor([1.5, 1e3, 1e5, 2.0**24, 2.0**25, 1e9, 1e12])
    far = torch.cat([torch.stack([at, -at], -1), torch.stack([at * 0, at], -1)])
    pdf = method.pdf(TILTED.conditions(1, generator(1)).expand(len(far), -1), far)
    assert pdf.isfinite().all() and (pdf >= 0).all()
    columns = columns_of(torch.cat([at, torch.tensor([math.nan])])[:, None])
    waves = tensor_of(*sinusoids_columns(columns, 4)[1:], rows=len(at) + 1)
    assert (waves[:-1].abs() <= 1 + 1e-5).all() and waves[-1].isnan().all()
    exact = sinusoids(at[:3, None].double(), 1)[:, 1:]
    torch.testing.assert_close(waves[:3, :2].double(), exact, rtol=0, atol=2e-4)


@pytest.mark.parametrize("couplings", [1, 3, 4])
@pytest.mark.parametrize("name", ["realnvp", "neural-spline-flow"])
def test_more_couplings_are_the_jacobian_of_the_whole_map(name, couplings):
    """The density against autograd's determinant of the map to the base."""
    method = fitted(name, couplings=couplings, uniform=0.0)
    net = method.module.double()
    condition = TILTED.conditions(6, generator(7)).double()
    wo = (torch.rand(6, 2, generator=generator(8), dtype=torch.float64) - 0.5) * 1.2
    full = torch.autograd.functional.jacobian(
        lambda v: method.to_base(net, condition, v[:, None])[0][:, 0], wo
    )
    index = torch.arange(6)
    log_det = torch.linalg.slogdet(full[index, :, index]).logabsdet
    z = method.to_base(net, condition, wo[:, None])[0][:, 0]
    expected = torch.distributions.Normal(0.0, 1.0).log_prob(z).sum(-1) + log_det
    torch.testing.assert_close(method.log_prob(condition, wo[:, None])[:, 0], expected)


@pytest.mark.parametrize("name", ["realnvp", "neural-spline-flow"])
def test_extremes_are_at_the_ends(name):
    """Complete states, finite, that draw samples together and apart."""
    method = fitted(name)
    condition, u = TILTED.conditions(500, generator(1)), torch.rand(500, 3, generator=generator(2))
    u[:, 2] = 0.5
    before = {key: value.clone() for key, value in method.state_dict().items()}
    ends = method.extremes()
    assert list(ends) == ["scale-to-0", "scale-to-infinity"]
    spread = {}
    for end, state in ends.items():
        assert state.keys() == before.keys()
        other = registry.make(name)
        other.bind(TILTED)
        other.load_state_dict(state)
        row = condition[:1].expand(500, -1)
        wo, pdf = other.sample(row, u)
        assert wo.isfinite().all() and pdf.isfinite().all() and (pdf >= 0).all()
        spread[end] = float((wo - wo.median(0).values).abs().median())
        if end == "scale-to-infinity":
            assert not inside_disk(wo).float().mean() > 0.01
    assert spread["scale-to-0"] < 1e-2 and spread["scale-to-infinity"] > 1e3
    assert all(torch.equal(v, before[k]) for k, v in method.state_dict().items())


@pytest.mark.parametrize("lobes", [1, 2, 5])
def test_lobes_are_a_mixture_by_hand(lobes):
    """The torch density against a sum of normals made from the network's bounded outputs."""
    method = fitted("two-lobe", lobes=lobes)
    condition = TILTED.conditions(16, generator(3))
    wo = (torch.rand(16, 8, 2, generator=generator(4)) * 2 - 1) * 0.7
    with torch.no_grad():
        out = method.module(condition)
        assert out.shape == (16, 5 * lobes + 1)
        mean, sigma = (
            out[:, : 2 * lobes],
            (10 * torch.tanh(out[:, 2 * lobes : 4 * lobes] / 10)).exp(),
        )
        weight = torch.softmax(10 * torch.tanh(out[:, 4 * lobes :] / 10), -1)
        expected = weight[:, :1] / math.pi * inside_disk(wo)
        for k in range(lobes):
            normal = torch.distributions.Normal(
                mean[:, None, 2 * k : 2 * k + 2], sigma[:, None, 2 * k : 2 * k + 2]
            )
            expected = expected + weight[:, k + 1, None] * normal.log_prob(wo).sum(-1).exp()
        torch.testing.assert_close(method.log_prob(condition, wo).exp(), expected)
    many = condition.repeat_interleave(8, 0)
    torch.testing.assert_close(
        method.pdf(many, wo.view(-1, 2)).view(16, 8), expected, rtol=1e-4, atol=1e-6
    )


def test_two_lobes_are_laid_out_as_ever():
    """Outputs of the paper's network: two means, two pairs of log sigmas, three logits."""
    method = registry.make("two-lobe")
    method.bind(TILTED)
    last = method.module.mlp.layers[-1]
    assert last.out_features == 11
    assert (last.bias[4:8] == -1).all() and not (last.bias == -1)[[0, 1, 2, 3, 8, 9, 10]].any()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.slow if n == "importance-baked" else ())
        for n in registry.names()
        if n not in UNFITTED and registry.load(n).exact_pdf
    ],
)
def test_bfloat16_halves_the_weights(name):
    """Rounded after fitting, stored in two bytes, restored bit for bit."""
    params = SMALL.get(name, {})
    few = replace(BUDGET, steps=4)
    short = fitted(name, few, precision="bfloat16", **params)
    long = fitted(name, few, **params)
    weights = sum(p.numel() for p in short.module.parameters())
    assert long.size_bytes() - short.size_bytes() == 2 * weights
    for p, q in zip(short.module.parameters(), long.module.parameters(), strict=True):
        assert p.dtype == torch.float32 and torch.equal(p, q.bfloat16().float())
    other = registry.make(name, precision="bfloat16", **params)
    other.bind(TILTED)
    other.load_state_dict(short.state_dict())
    condition, u = TILTED.conditions(64, generator(1)), torch.rand(64, 3, generator=generator(2))
    assert torch.equal(other.sample(condition, u).wo, short.sample(condition, u).wo)
    with pytest.raises(InputError, match="'float32' or 'bfloat16'"):
        registry.load(name)(precision="float16")


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("realnvp", {"couplings": 0}),
        ("realnvp", {"layers": 0}),
        ("neural-spline-flow", {"couplings": -1}),
        ("neural-spline-flow", {"layers": 0}),
        ("two-lobe", {"lobes": 0}),
        ("flow-matching", {"steps": 0}),
        ("flow-matching", {"layers": 0}),
    ],
)
def test_bad_values_are_refused(name, params):
    with pytest.raises(InputError, match=f"^{name}.*at least"):
        registry.load(name)(**params)
