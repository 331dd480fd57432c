"""The catalogue of hard cases: rows that are what they say, and states that can be loaded."""

from __future__ import annotations

import copy
import functools
import math

import pytest
import torch
from torch import Tensor, nn

from harness.checks import hard_conditions as at
from harness.checks import hard_states as states
from harness.checks import properties
from harness.checks.catalogue import BASE, CATALOGUE, GROUPS
from harness.core import registry as methods
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.materials import registry as materials
from tests.materials import Plain, Tilted

BUDGET = Budget(steps=10, conditions=16, directions=16, resolution=16, pool=64)
FITTED = ["blinn-phong", "fan-baseline", "improved-baseline", "two-lobe"]
FITTED += ["realnvp", "neural-spline-flow", "histogram"]
LOBES = FITTED[:4]
FLOWS = FITTED[4:6]
ASKED = (
    "normal grazing-1e-2 grazing-1e-3 grazing-1e-4 grazing-1e-5 grazing-1e-6 horizontal"
    " specular-1e-1 specular-1e-2 specular-1e-3 specular-1e-4 anisotropic-100 below-horizon"
    " rim-lobe distant-lobes constant polished-disney polished-ggx-conductor polished-layered"
    " black-texels black-hemisphere bright-pixel measured-holes blue-only far-features"
    " untrained badly-trained large-outputs sigma-to-0 sigma-to-infinity weights-to-0"
    " uniform-to-0 bfloat16-weights u-corners bin-edges outside-disk nan-inputs half-million-rows"
    " double-precision bfloat16-inputs"
).split()


def stream(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@functools.cache
def material(name: str) -> Material:
    return Tilted() if name == "tilted" else materials.make(name)


@functools.cache
def fitted(name: str) -> Method:
    method = methods.make(name)
    method.fit(material("tilted"), BUDGET, stream())
    return method


def loaded(name: str, state: dict[str, Tensor], seed: int = 0) -> Method:
    """A new method with that state."""
    method = methods.make(name)
    method.bind(material("tilted"))
    method.load_state_dict(state)
    return method


def outputs(method: Method, n: int = 2048) -> DiskSample:
    generator = stream(1)
    condition = material("tilted").conditions(n, generator)
    return method.sample(condition, torch.rand(n, 3, generator=generator))


# --- the table -------------------------------------------------------------------------


def test_every_case_of_the_issue_is_there_in_the_order_of_the_groups():
    assert list(CATALOGUE) == ASKED
    order = [GROUPS.index(case.group) for case in CATALOGUE.values()]
    assert order == sorted(order) and set(order) == set(range(len(GROUPS)))


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_case_is_whole(name):
    """Names of properties and of the material exist; one sentence says what it is."""
    case = CATALOGUE[name]
    assert case.name == name and case.about and "\n" not in case.about
    materials.validate(case.material)
    assert set(case.checks) <= set(properties.PER_CASE)
    if case.inputs:
        assert case.inputs in {*properties.PER_METHOD, *properties.PER_CASE}
    assert (case.group == "input") == bool(case.inputs)
    assert (case.group == "state") == (case.alter is not None)


@pytest.mark.parametrize("name", [n for n, case in CATALOGUE.items() if not case.inputs])
def test_conditions(name):
    """At most two rows of the material's layout, finite, the same from the same generator."""
    case, own = CATALOGUE[name], material(CATALOGUE[name].material)
    found = case.conditions(own, stream(), "cpu")
    assert found.shape[1] == own.n_condition and 1 <= len(found) <= 2
    assert found.isfinite().all()
    assert torch.equal(found, case.conditions(own, stream(), "cpu"))
    # One row at least has something to sample; of black texels one has not.
    wo = torch.rand(1, 4096, 2, generator=stream(2)) * 2 - 1
    lit = (own.target_grid(found, wo) > 0).any(1).tolist()
    assert lit == ([False, True] if name == "black-texels" else [True] * len(found))


# --- directions ------------------------------------------------------------------------


@pytest.mark.parametrize("power", range(2, 7))
def test_grazing(power):
    """One row has the cosine, in exact and in single-precision arithmetic; the other is near."""
    cosine = 10.0**-power
    rows = CATALOGUE[f"grazing-1e-{power}"].conditions(material(BASE), stream(), "cpu")
    assert rows.dtype == torch.float32
    exact, rounded = (1 - rows[:, -2:].double().square().sum(1)).tolist()
    assert exact == pytest.approx(cosine**2, rel=0.02)
    x, y = rows[0, -2:]
    assert (1 - x * x - y * y).item() == pytest.approx(cosine**2, rel=0.05)
    assert rounded == pytest.approx(cosine**2, abs=2e-7)
    assert (rounded < 0) == (power >= 4)


def test_horizontal_is_horizontal_in_any_precision():
    rows = CATALOGUE["horizontal"].conditions(material(BASE), stream(), "cpu")[:, -2:]
    for dtype in (torch.float32, torch.float64):
        assert (rows.to(dtype).square().sum(1) == 1).all()


def test_normal_has_no_azimuth():
    rows = CATALOGUE["normal"].conditions(material(BASE), stream(), "cpu")[:, -2:]
    assert (rows[0] == 0).all() and 0 < rows[1].norm() < 1e-8


@pytest.mark.parametrize("name", ["disney", "ggx-conductor", "layered"])
def test_polished(name):
    """The least roughness that is drawn, and the angles stated."""
    own = material(name)
    rows = CATALOGUE[f"polished-{name}"].conditions(own, stream(), "cpu")
    cosine = (1 - rows[:, -2:].double().square().sum(1)).sqrt()
    torch.testing.assert_close(cosine, torch.tensor([0.1, 0.01]).double(), rtol=0.02, atol=0)
    at_low = [
        p.name
        for p, column in zip(own.parameters, rows.T, strict=False)
        if (column == torch.tensor(p.low)).all()
    ]
    assert at_low == [p.name for p in own.parameters if p.name[:5] in ("alpha", "rough")]


def test_far_features():
    """As many deviations away as stated, measured on other conditions; address and wi stay."""
    own = material(BASE)
    rows = CATALOGUE["far-features"].conditions(own, stream(), "cpu")
    first, last = own.n_address, own.n_address + own.n_features
    seen = own.conditions(4096, stream(9))[:, first:last]
    away = (rows[:, first:last] - seen.mean(0)) / seen.std(0)
    assert last > first
    torch.testing.assert_close(away[0], torch.full_like(away[0], 1e3), rtol=0.2, atol=0)
    torch.testing.assert_close(away[1], torch.full_like(away[1], -1e6), rtol=0.2, atol=0)
    near = at.normal_and_oblique(own, stream(), "cpu")
    assert torch.equal(rows[:, :first], near[:, :first]) and torch.equal(rows[:, -2:], near[:, -2:])


def test_black_and_lit():
    rows = CATALOGUE["black-texels"].conditions(material("black-texels"), stream(), "cpu")
    assert rows[:, 0].tolist() == [0, 1]


# --- states ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", FITTED)
@pytest.mark.parametrize(
    "alter",
    [states.untrained, states.badly_trained, states.large_outputs, states.bfloat16_weights],
)
def test_altered_state(name, alter):
    """Complete, other than the fitted one, reproducible; the method itself is left as it was."""
    method = fitted(name)
    before = copy.deepcopy(method.state_dict())
    state = alter(method, stream(3))
    assert set(state) == set(before)
    assert any(not torch.equal(state[k], before[k]) for k in before)
    again = alter(method, stream(3))
    assert all(torch.equal(state[k], again[k]) for k in state)
    if alter is not states.bfloat16_weights:
        # Two outputs have four pairs of signs: of eight others one at least differs.
        others = [alter(method, stream(seed)) for seed in range(4, 12)]
        assert any(not torch.equal(state[k], other[k]) for k in state for other in others)
    after = method.state_dict()
    assert all(torch.equal(before[k], after[k]) for k in before)
    changed = loaded(name, state)
    assert all(torch.equal(changed.state_dict()[k], state[k]) for k in state)


@pytest.mark.parametrize("name", FITTED)
def test_only_weights_are_spoiled(name):
    """Buffers are not trained: the encoder's scale, or a table, stays as it is."""
    method = fitted(name)
    state, before = states.badly_trained(method, stream()), method.state_dict()
    trained = {k for k, p in method.module.named_parameters() if p.requires_grad}
    assert {k for k in state if not torch.equal(state[k], before[k])} == trained
    assert set(state) - trained


def test_noise_has_the_stated_size():
    method = fitted("improved-baseline")
    state, before = states.badly_trained(method, stream()), method.state_dict()
    weight = "mlp.layers.1.weight"
    noise = (state[weight] - before[weight]).std() / before[weight].std()
    assert noise == pytest.approx(states.NOISE, rel=0.1)


def test_large_outputs_are_those_of_the_last_layers():
    method = fitted("neural-spline-flow")
    state, before = states.large_outputs(method, stream()), method.state_dict()
    changed = [k for k in state if not torch.equal(state[k], before[k])]
    assert len(changed) == 3 and all(k.endswith(".bias") for k in changed)
    for k in changed:
        assert set(state[k].unique().tolist()) == {-states.LARGE, states.LARGE}


def test_bfloat16_weights_are_bfloat16_numbers():
    state = states.bfloat16_weights(fitted("two-lobe"), stream())
    weight = state["mlp.layers.0.weight"]
    assert torch.equal(weight, weight.bfloat16().float())


@pytest.mark.parametrize("name", ["cosine", "tabulated"])
@pytest.mark.parametrize("case", [n for n, case in CATALOGUE.items() if case.alter])
def test_a_method_without_networks_has_no_such_state(name, case):
    method = methods.make(name)
    method.fit(material("tilted"), BUDGET, stream())
    assert CATALOGUE[case].alter(method, stream()) is None


class Own(Method):
    """A user's method: a network of their own making, whatever it is called, and a table."""

    name = "own"

    def bind(self, material: Material) -> None:
        self.material = material
        self.brain = nn.Sequential(nn.Linear(4, 8), nn.ReLU(), nn.Linear(8, 2))
        self.table = torch.linspace(0, 1, 5)

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        raise NotImplementedError

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        raise NotImplementedError

    def state_dict(self) -> dict[str, Tensor]:
        return {"table": self.table, **{k: v.detach() for k, v in self.brain.state_dict().items()}}


def test_a_users_network_is_found():
    own = Own()
    own.bind(material("tilted"))
    before = {k: v.clone() for k, v in own.state_dict().items()}
    for alter in (states.untrained, states.badly_trained, states.bfloat16_weights):
        state = alter(own, stream())
        assert torch.equal(state["table"], before["table"])
        assert not torch.equal(state["0.weight"], before["0.weight"])
    large = states.large_outputs(own, stream())
    assert large["2.bias"].abs().tolist() == [states.LARGE] * 2
    assert torch.equal(large["0.bias"], before["0.bias"])
    assert all(torch.equal(before[k], v) for k, v in own.state_dict().items())


# --- ends of the parameters' range -----------------------------------------------------


@pytest.mark.parametrize("name", LOBES + FLOWS)
def test_narrowest_and_widest(name):
    """Narrow lobes put the samples of one condition close together, wide ones off the disk."""
    row = material("tilted").conditions(1, stream(5)).expand(4096, -1).clone()
    row[:, -2:] = torch.tensor([0.3, 0.2])
    u = torch.rand(4096, 3, generator=stream(6))
    narrow = CATALOGUE["sigma-to-0"].alter(fitted(name), stream())
    wide = CATALOGUE["sigma-to-infinity"].alter(fitted(name), stream())
    wo, pdf = loaded(name, narrow).sample(row, u)
    assert wo.isfinite().all() and pdf.isfinite().all()
    # Lobes beside a share of the uniform disk: a third at least are in the lobes.
    assert pdf.quantile(0.75) > 1e4
    wo, pdf = loaded(name, wide).sample(row, u)
    assert wo.isfinite().all() and pdf.isfinite().all()
    if name == "blinn-phong":
        # At exponent 0 half vectors are uniform: wide, and at most half below the horizon.
        assert pdf.max() < 100
    else:
        assert (wo.square().sum(1) >= 1).double().mean() > 0.4


@pytest.mark.parametrize("name", ["improved-baseline", "two-lobe", "fan-baseline"])
def test_weights_to_0(name):
    """Without lobes, the uniform disk; without the uniform disk, a lobe that has it all."""
    uniform = loaded(name, CATALOGUE["weights-to-0"].alter(fitted(name), stream()))
    wo, pdf = outputs(uniform)
    torch.testing.assert_close(pdf, torch.full_like(pdf, 1 / torch.pi))
    assert (wo.square().sum(1) < 1).all()
    alone = loaded(name, CATALOGUE["uniform-to-0"].alter(fitted(name), stream()))
    assert ((outputs(alone).pdf - 1 / torch.pi).abs() > 1e-6).double().mean() > 0.99


def test_weights_to_0_of_blinn_phong():
    """Its one logit ends at +-10 from the other's zero, so each lobe keeps e^-10 of the weight."""
    share = 1 / (1 + math.exp(10))
    condition = material("tilted").conditions(2048, stream(1))
    wo = 0.9 * material("tilted").conditions(2048, stream(2))[:, -2:]
    diffuse, glossy = (
        loaded("blinn-phong", CATALOGUE[case].alter(fitted("blinn-phong"), stream()))
        .pdf(condition, wo)
        .double()
        for case in ("weights-to-0", "uniform-to-0")
    )
    lobe = (glossy - share / math.pi) / (1 - share)
    torch.testing.assert_close(diffuse, (1 - share) / math.pi + share * lobe, rtol=2e-6, atol=0)
    # The lobe is there to be told from the disk, at nearly every direction.
    assert ((lobe * math.pi - 1).abs() > 0.01).double().mean() > 0.9


@pytest.mark.parametrize("name", ["improved-baseline", "two-lobe", "fan-baseline"])
def test_weights_at_the_ends_of_their_range(name):
    """One of them all but one, the others tiny; none is zero, where light would be lost."""
    condition = material("tilted").conditions(64, stream(7))
    for case, lit in (("weights-to-0", 0), ("uniform-to-0", 1)):
        state = CATALOGUE[case].alter(fitted(name), stream())
        weight = loaded(name, state).lobes(condition).log_weight.detach().exp()
        assert (weight[:, lit] > 1 - 1e-6).all()
        others = torch.cat([weight[:, :lit], weight[:, lit + 1 :]], 1)
        assert ((others > 0) & (others < 1e-6)).all()


@pytest.mark.parametrize("name", ["improved-baseline", "two-lobe", "fan-baseline"])
def test_outputs_are_recognised(name):
    """Which outputs are deviations and weights, as the docstrings of the methods list them."""
    expected = {
        "improved-baseline": ([2], {3: 0, 4: 1}),
        "two-lobe": ([4, 5, 6, 7], {8: 0, 9: 1, 10: 2}),
        "fan-baseline": ([0], {1: 0, 2: 1}),
    }
    assert fitted(name)._roles() == expected[name]


def test_extremes_of_a_material_without_features():
    """Blinn-Phong has two plain constants there."""
    method = methods.make("blinn-phong")
    method.fit(Plain(), BUDGET, stream())
    found = method.extremes()
    assert found["exponent-to-infinity"]["constant"].tolist() == [100.0, 0.0]
    assert found["uniform-to-0"]["constant"][1] == 100
    assert found["uniform-to-0"]["constant"][0] == method.state_dict()["constant"][0]


@pytest.mark.slow
def test_extremes_of_the_histogram_mixture():
    """A few cells for each basis, a flat disk, and one basis alone."""
    name = "histogram-mixture"
    row = material("tilted").conditions(1, stream(5)).expand(4096, -1).clone()
    u = torch.rand(4096, 3, generator=stream(6))

    def drawn(case: str) -> tuple[torch.Tensor, torch.Tensor]:
        method = loaded(name, CATALOGUE[case].alter(fitted(name), stream()))
        wo, pdf = method.sample(row, u)
        assert wo.isfinite().all() and (pdf > 0).all()
        return wo, pdf

    cells = fitted(name).resolution ** 2
    wo, pdf = drawn("sigma-to-0")
    # One or two cells for each basis hold what is not spread evenly.
    assert float(pdf.median()) > cells / 4 / fitted(name).bases / 4
    wo, pdf = drawn("sigma-to-infinity")
    inner = wo.norm(dim=1) < 0.9
    torch.testing.assert_close(
        pdf[inner], torch.full_like(pdf[inner], 1 / math.pi), rtol=0.02, atol=0
    )
    drawn("uniform-to-0")
    alone = loaded(name, CATALOGUE["uniform-to-0"].alter(fitted(name), stream()))
    weight = alone.module.gates(row[:1]).log_weight.detach().exp()[0]
    assert weight[0] == 1 and weight[1:].sum() == 0
