"""Parametric families: what every one promises, and Disney's against Mitsuba's own plugin."""

from __future__ import annotations

import json
import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.materials import registry
from harness.materials.families.base import SWATCHES
from harness.materials.families.hashing import generator_at
from harness.materials.families.parameters import Parameter
from harness.materials.families.registry import FAMILIES

NAMES = registry.family_names()
each = pytest.mark.parametrize("name", NAMES)


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def fixed(name: str, **fix: float) -> Material:
    return registry.make({"name": "mine", "type": "family", "family": name, "fix": fix})


@pytest.fixture(autouse=True)
def _short_tables(monkeypatch):
    """Few walks for the slices of layers: their means are tested, not their noise."""
    monkeypatch.setattr("harness.materials.families.layered.TABLE_WALKS", 1024)


# --- every family ----------------------------------------------------------------------


@each
def test_conditions_cover_the_ranges(name):
    """A feature for every free parameter; draws fill the range and stay in it."""
    material = registry.make(name)
    condition = material.conditions(4096, rng(0))
    assert material.n_address == 0 and condition.shape[1] == material.n_condition
    assert [p.name for p in material.parameters] == [
        p.name for p in FAMILIES[name].model if p.default is None
    ]
    for column, p in zip(condition.T, material.parameters, strict=False):
        assert p.least <= p.low < p.high <= p.most
        assert p.low <= column.min() and column.max() <= p.high * (1 + 1e-6)
        assert column.max() - column.min() > 0.99 * (p.high - p.low)
    assert inside_disk(condition[:, -2:]).all()


@each
def test_places_have_parameters_in_range(name):
    """What a surface shows are rows of the family, and more than one of them."""
    material = registry.make(name)
    # Beyond the unit square too: scenes repeat their textures.
    place = material.places(4 * torch.rand(2048, 2, generator=rng(1)) - 2)
    assert place.shape == (2048, material.n_features)
    for column, p in zip(place.T, material.parameters, strict=True):
        assert p.low <= column.min() and column.max() <= p.high * (1 + 1e-6)
    tiles = len(place.unique(dim=0))
    assert tiles == SWATCHES**2 if material.n_features > 2 else tiles > 1000


@each
def test_fixed_parameters_are_no_features(name):
    """A fixed parameter gives what the same value in a row gives."""
    material = registry.make(name)
    condition = material.conditions(16, rng(2))
    wo = square_to_disk(torch.rand(16, 2, generator=rng(3)))
    condition[:, :-2] = condition[0, :-2]
    pinned = {p.name: condition[0, i].item() for i, p in enumerate(material.parameters)}
    some = dict(list(pinned.items())[1:])
    expected = material.eval(condition, wo)
    for fix in (pinned, some):
        other = fixed(name, **fix)
        rows = torch.cat([condition[:, : len(pinned) - len(fix)], condition[:, -2:]], 1)
        assert other.n_features == len(pinned) - len(fix)
        torch.testing.assert_close(other.eval(rows, wo), expected, rtol=2e-4, atol=1e-6)


@each
def test_value_does_not_depend_on_the_batch(name):
    """f is a function: asked twice, alone or in another order, it is the same."""
    material = registry.make(name)
    condition = material.conditions(32, rng(4))
    wo = square_to_disk(torch.rand(32, 2, generator=rng(5)))
    value = material.eval(condition, wo)
    assert torch.equal(material.eval(condition, wo), value)
    order = torch.randperm(32, generator=rng(6))
    assert torch.equal(material.eval(condition[order], wo[order]), value[order])
    torch.testing.assert_close(material.eval(condition[:1], wo[:1]), value[:1])
    torch.testing.assert_close(
        material.target_grid(condition, wo[None]).diagonal(), material.target(condition, wo)
    )


@each
def test_slices_are_means_of_eval(name):
    """Coarse cells, inside and across the rim, over many seeds, against uniform points in each."""
    material = registry.make(name)
    condition = material.conditions(3, rng(7))
    n, count = 4, 8192
    found = torch.stack([material.slices(condition, n, seed) for seed in range(24)])
    assert found.shape == (24, 3, n, n, 3)
    u = torch.rand(n, n, count, 2, generator=rng(8))
    row, column = torch.meshgrid(torch.arange(n), torch.arange(n), indexing="ij")
    corner = torch.stack([column, row], -1)[:, :, None]
    wo = (2 * (corner + u) / n - 1).reshape(-1, 2)
    for i, c in enumerate(condition):
        value = material.eval(c.expand(len(wo), -1), wo).view(n, n, count, 3)
        error = (value.var(2) / count + found[:, i].var(0) / len(found)).sqrt()
        assert ((found[:, i].mean(0) - value.mean(2)).abs() <= 5 * error + 1e-6).all()


@each
def test_slices_hold_a_lobe_narrower_than_a_cell(name):
    """At the least roughness the sum of a coarse slice is the mean weight of the sampler."""
    from harness._methods.native import Native

    fix = {p.name: p.low for p in FAMILIES[name].model if p.name.startswith(("alpha", "rough"))}
    material, method, n = fixed(name, **fix), Native(), 1 << 16
    method.bind(material)
    for row in material.conditions(3, rng(19)):
        rows = row.expand(n, -1).contiguous()
        weight = method.sample_weighted(rows, torch.rand(n, 3, generator=rng(20))).weight
        error = weight.std(0) / math.sqrt(n)
        energy = material.slices(row[None], 64, 0)[0].sum((0, 1)) * (2 / 64) ** 2
        assert ((energy - weight.mean(0)).abs() <= 5 * error + 0.02 * energy).all()


@each
def test_slices_by_seed_and_row(name):
    material = registry.make(name)
    condition = material.conditions(3, rng(9))
    one = material.slices(condition, 8, 1)
    assert torch.equal(material.slices(condition, 8, 1), one)
    assert torch.equal(material.slices(condition[1:2], 8, 1)[0], one[1])
    assert not torch.equal(material.slices(condition, 8, 2), one)
    assert (one[:, 0, 0] == 0).all() and one.isfinite().all()
    assert material.slices(condition[:0], 8, 1).shape == (0, 8, 8, 3)


@each
def test_calls_of_no_rows(name):
    material = registry.make(name)
    condition, wo = material.conditions(0, rng(0)), torch.empty(0, 2)
    assert material.eval(condition, wo).shape == (0, 3)
    assert material.target(condition, wo).shape == (0,)
    assert material.target_grid(condition, torch.empty(1, 0, 2)).shape == (0, 0)
    assert material.places(wo).shape == (0, material.n_features)


@each
def test_zero_off_the_disk_and_finite_on_it(name):
    material = registry.make(name)
    condition = material.conditions(256, rng(10))
    turn = torch.rand(256, 1, generator=rng(11)) * 2 * math.pi
    rim = torch.cat([turn.cos(), turn.sin()], 1)
    assert (material.eval(condition, 1.001 * rim) == 0).all()
    for wo in (0.9999 * rim, -condition[:, -2:], condition[:, -2:]):
        value = material.eval(condition, wo)
        assert value.isfinite().all() and (value >= 0).all()


# --- specifications --------------------------------------------------------------------


@each
def test_named_three_ways(name):
    written = {"name": name, "type": "family", "family": name}
    assert (
        registry.identity(name) == registry.identity(written) == registry.identity({"name": name})
    )
    assert registry.make(name).name == name
    assert "\n" not in registry.describe(name) and name not in registry.names()
    p = FAMILIES[name].model[0]
    other = registry.identity({**written, "fix": {p.name: p.high}})
    assert other != registry.identity(name) and "/" not in json.dumps(other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"family": "disny"}, "unknown family 'disny'; did you mean 'disney'?"),
        ({"family": 3}, "unknown family 3"),
        ({"fix": 3}, "fix: expected a mapping, got 3"),
        ({"fix": {"rough": 0.1}}, "unknown parameter 'rough'; did you mean 'roughness'?"),
        ({"fix": {"roughness": 1.5}}, "roughness: expected a number from 0 to 1, got 1.5"),
        ({"fix": {"roughness": "low"}}, "expected a number from 0 to 1, got 'low'"),
        ({"fix": {"roughness": math.nan}}, "expected a number"),
        ({"fix": {"roughness": True}}, "expected a number"),
        ({"fixed": {}}, "unknown key 'fixed'; did you mean 'fix'?"),
    ],
)
def test_refused(change, message):
    spec = {"name": "mine", "type": "family", "family": "disney", **change}
    for call in (registry.validate, registry.identity, registry.make):
        with pytest.raises(InputError) as refused:
            call(spec)
        assert message in str(refused.value) and "\n" not in str(refused.value)


def test_a_misspelt_bare_name():
    with pytest.raises(InputError, match="did you mean 'disney'"):
        registry.make("disnye")


# --- parameters and random numbers -----------------------------------------------------


@settings(deadline=None)
@given(t=st.floats(0, 1), low=st.floats(0, 1), width=st.floats(1e-3, 2))
def test_squared_parameters(t, low, width):
    """The square root of what is drawn is uniform between the roots of the ends."""
    p = Parameter("alpha", low, low + width, 0, 3, squared=True)
    value = p.at(torch.tensor(t, dtype=torch.float64)).item()
    share = (math.sqrt(value) - math.sqrt(low)) / (math.sqrt(low + width) - math.sqrt(low))
    assert share == pytest.approx(t, abs=1e-6)


def test_hashed_generators():
    """Uniform over neighbouring inputs, equal for equal ones, zero of either sign, new by seed."""
    from harness.core.columns.bridge import columns_of, tensor_of

    n = 1 << 16
    near = torch.stack([1 + torch.arange(n) * 2.0**-23, torch.full((n,), 0.3)], 1)

    def draw(rows: torch.Tensor, seed: int) -> torch.Tensor:
        generator = generator_at(columns_of(rows), seed)
        return tensor_of(generator.next_float32(), generator.next_float32(), rows=len(rows))

    value = draw(near, 7)
    assert torch.equal(draw(near, 7), value)
    for other in (draw(near, 8), draw(near, 7 + (1 << 32)), draw(near.flip(1), 7)):
        assert (other != value).float().mean() > 0.99
    table = torch.histc(value[:, 0] * 16 // 1 * 16 + value[:, 1] * 16 // 1, 256, -0.5, 255.5)
    chi_square = (table - n / 256).square().sum().item() / (n / 256)
    assert abs(chi_square - 255) < 6 * math.sqrt(2 * 255)
    signs = torch.tensor([[0.0, 0.5], [-0.0, 0.5]])
    a, b = draw(signs, 1)  # and whatever its place in the batch
    assert torch.equal(a, b)


# --- Disney ----------------------------------------------------------------------------


def test_disney_is_mitsubas_principled():
    """Rows of any parameters against the plugin with those parameters, in its own process."""
    import mitsuba as mi

    from harness.materials.families.disney import BASE_COLOR
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    material = registry.make("disney")
    condition = material.conditions(6, rng(12))
    for row in condition:
        plain = {
            "type": "principled",
            "base_color": {"type": "rgb", "value": list(BASE_COLOR)},
            "metallic": row[0].item(),
            "roughness": row[1].item(),
        }
        assert mi.variant() is not None
        other = MitsubaMaterial("plain", plain, {})
        wo = square_to_disk(torch.rand(512, 2, generator=rng(13)))
        found = material.eval(row.expand(512, -1), wo)
        expected = other.eval(row[-2:].expand(512, -1), wo)
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


def test_disney_on_a_surface_is_its_row():
    """The BSDF that renders natively has, at (u, v), the parameters of ``places``."""
    import drjit as dr
    import mitsuba as mi

    from harness.core.columns.bridge import columns_of, tensor_of

    material = registry.make("disney")
    uv = torch.rand(512, 2, generator=rng(14))
    wi, wo = (square_to_disk(torch.rand(512, 2, generator=rng(s))) for s in (15, 16))
    condition = torch.cat([material.places(uv), wi], 1)
    si = material._nested.interaction([*columns_of(uv), *columns_of(wi)])
    rows = tensor_of(*material.condition_columns(si), rows=512)
    torch.testing.assert_close(rows, condition)
    x, y = columns_of(wo)
    z = dr.sqrt(1 - x * x - y * y)
    f = material.bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(x, y, z)) / z
    torch.testing.assert_close(
        tensor_of(*f, rows=512), material.eval(condition, wo), rtol=1e-4, atol=1e-6
    )


@pytest.mark.slow
def test_the_speed_command(monkeypatch, capsys):
    """Prints one line a case, with seven figures; what they are is no matter of a test."""
    from harness.bench import families as speed

    sizes = {"RESOLUTION": 8, "WALKS": 256, "EVALUATIONS": 64}
    for name, value in sizes.items():
        monkeypatch.setattr(speed, name, value)
    monkeypatch.setattr("sys.argv", ["speed", "--rounds", "1"])
    speed.main()
    head, *lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(speed.CASES) and "slice s" in head
    for line, name in zip(lines, speed.CASES, strict=True):
        assert line.startswith(name) and len(line[24:].split()) == 7


@pytest.mark.parametrize("fix", [{}, {"roughness": 0.3}])
def test_scenes_show_what_its_conditions_say_on_every_tile(fix):
    """Its texture coordinates go beyond one: what is not carried is refused at true hits."""
    from harness.core import registry as methods
    from harness.rendering.prepared import prepare
    from harness.scenes import registry as scenes

    material = fixed("disney", **fix)
    method = methods.make("cosine")
    method.bind(material)
    assert prepare(scenes.make("studio-sphere"), material, method, 16).mask.any()
