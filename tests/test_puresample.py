"""Materials learned from walks: networks, densities, samplers, files."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from scipy.special import sph_harm_y

from harness.core.protocol.disk import disk_to_square, luminance, square_to_disk, to_direction
from harness.core.protocol.errors import InputError, Unsupported
from harness.materials import registry
from harness.materials.puresample import files, storage
from harness.materials.puresample.architecture import Architecture
from harness.materials.puresample.harmonics import COUNT, harmonics
from harness.materials.puresample.network import PureSample
from harness.mitsuba_runtime import variant
from harness.nets.domains import to_disk
from harness.stats.chisquare import chi_square

mi = variant.use("cpu")

from harness._methods.cosine import Cosine  # noqa: E402
from harness._methods.native import Native  # noqa: E402
from harness._methods.puresample import PureSample as Sampler  # noqa: E402
from harness.checks.run import run_checks  # noqa: E402
from harness.materials.puresample.material import PureSampleMaterial  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402
from harness.scenes import registry as scenes  # noqa: E402
from harness.stats.ztest import agreement  # noqa: E402

SMALL = Architecture(width=12, layers=2, steps=3, albedo_width=8)
FORMS = {
    "plane": SMALL,
    "disk": replace(SMALL, domain="disk", base="gaussian", share=0.1),
    "grey": replace(SMALL, grey=True, base="normal"),
    "textured": replace(SMALL, resolution=4, channels=3, residual=True, albedo_layers=5),
}


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def network(form: str, seed: int = 1) -> PureSample:
    """Weights at random, gentle enough that the steps are one to one."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        net = PureSample(FORMS[form])
        with torch.no_grad():
            for layer in (net.density.velocity.layers[-1],):
                layer.weight.normal_(std=0.25)
            if net.density.base.net is not None:
                net.density.base.net.layers[-1].weight.normal_(std=0.1)
    return net.eval()


def material(form: str) -> PureSampleMaterial:
    return PureSampleMaterial("mine", network(form), {"type": "test", "form": form})


def quadrature(domain: str, side: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions [side^2, 2] and weights of an integral over the disk.

    In the plane's own coordinates where the density may rise without bound towards the rim.
    """
    at = (torch.arange(side) + 0.5) / side
    if domain == "disk":
        return square_to_disk(torch.cartesian_prod(at, at)), torch.full(
            (side**2,), math.pi / side**2
        )
    reach = 5.0
    z = (2 * at - 1) * reach
    wo = to_disk("plane", torch.cartesian_prod(z, z).double())
    slope = (1 - wo.square().sum(1)) / 2
    return wo.float(), (slope * (2 * reach / side) ** 2).float()


# --- harmonics -------------------------------------------------------------------------


def test_harmonics_are_scipys():
    w = to_direction(square_to_disk(torch.rand(200, 2, generator=rng(1), dtype=torch.float64)))
    x, y, z = w.unbind(1)
    found = torch.stack(harmonics(x, y, z), 1)
    theta, phi = torch.acos(z).numpy(), torch.atan2(y, x).numpy()
    k = 0
    for degree in range(5):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), theta, phi)
            part = value.imag if order < 0 else value.real
            # The phase (-1)^m is scipy's and not that of real harmonics.
            scale = 1 if order == 0 else math.sqrt(2) * (-1) ** order
            expected = torch.from_numpy(scale * part)
            torch.testing.assert_close(found[:, k], expected, rtol=1e-9, atol=1e-9)
            k += 1
    assert k == COUNT == found.shape[1]


# --- reflectance -----------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_columns_are_the_networks(form):
    """f over columns is density x albedo in torch, channel by channel, and zero off the disk."""
    m = material(form)
    condition = m.conditions(300, rng(2))
    wo = square_to_disk(torch.rand(300, 2, generator=rng(3)))
    wo[:10] *= 2
    f = m.eval(condition, wo)
    inside = wo.square().sum(1) < 1
    assert (f[~inside] == 0).all() and (f[inside] > 0).all()
    features, wi, net = condition[:, :-2], condition[:, -2:], m.network
    with torch.no_grad():
        for k in range(3):
            channel = torch.full((300,), k)
            expected = (
                net.log_density(features, channel, wi, wo).exp() * net.albedo(features, wi)[:, k]
            )
            torch.testing.assert_close(f[inside, k], expected[inside], rtol=1e-3, atol=1e-5)
    if form == "grey":
        assert (f == f[:, :1]).all()
    assert m.n_features == net.architecture.channels and condition.shape[1] == m.n_condition


@pytest.mark.parametrize("form", ["plane", "textured"])
def test_the_integral_is_the_albedo(form):
    m, side = material(form), 200
    for row in m.conditions(3, rng(4)):
        wo, weight = quadrature("plane", side)
        f = m.eval(row.expand(len(wo), -1).contiguous(), wo)
        total = (f.double() * weight[:, None]).sum(0)
        expected = m.albedo(row[None])[0].double()
        torch.testing.assert_close(total, expected, rtol=3e-3, atol=0)


# --- samplers --------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("channel", ["highest", "mixture"])
def test_samplers_draw_their_density(form, channel):
    m, n, side = material(form), 1 << 15, 8
    method = Sampler(channel)
    method.bind(m)
    row = m.conditions(2, rng(5))[1]
    rows = row.expand(n, -1).contiguous()
    found = method.sample(rows, torch.rand(n, 3, generator=rng(6)))
    again = method.pdf(rows, found.wo)
    inside = found.wo.square().sum(1) < 1
    torch.testing.assert_close(found.pdf[inside], again[inside], rtol=2e-3, atol=1e-5)
    wo, weight = quadrature(m.network.architecture.domain, 400)
    density = method.pdf(row.expand(len(wo), -1).contiguous(), wo).double() * weight
    mass = torch.zeros(side**2, dtype=torch.float64).index_add_(0, cell_of(wo, side), density)
    count = torch.bincount(cell_of(found.wo[inside], side), minlength=side**2)
    observed = torch.cat([count, (~inside).sum()[None]]).double()
    # What is left of one: off the disk, or less than nothing by the integral's error.
    expected = n * torch.cat([mass, (1 - mass.sum())[None]])
    variance = (5e-3 * expected).square() + (2e-3 * n / side) ** 2
    assert chi_square(observed, expected, variance).p_value > 1e-5


def cell_of(wo: torch.Tensor, side: int) -> torch.Tensor:
    at = (disk_to_square(wo.double()) * side).long().clamp(0, side - 1)
    return at[:, 0] * side + at[:, 1]


def test_the_mixture_is_the_target_and_the_highest_channel_is_not():
    """Weights of luminance by the mixture do not vary; by one channel they do."""
    m, n = material("plane"), 4096
    condition, u = m.conditions(n, rng(7)), torch.rand(n, 3, generator=rng(8))
    spread = {}
    for channel in ("highest", "mixture"):
        method = Sampler(channel)
        method.bind(m)
        weight = luminance(method.sample_weighted(condition, u).weight)
        expected = luminance(m.albedo(condition))
        spread[channel] = float((weight / expected).std())
        assert float((weight / expected).mean()) == pytest.approx(1, abs=0.02)
    assert spread["mixture"] < 2e-3 < 0.01 < spread["highest"]
    native = Native()
    native.bind(m)
    torch.testing.assert_close(
        native.pdf(condition, u[:, :2] - 0.5), method.pdf(condition, u[:, :2] - 0.5)
    )


def test_the_sampler_refuses_other_materials_and_words():
    with pytest.raises(Unsupported, match="not learned from walks"):
        Sampler().bind(registry.make("ggx-conductor"))
    with pytest.raises(InputError, match="hihgest.*highest"):
        Sampler("hihgest")


@pytest.mark.slow
def test_checks_pass():
    for channel in ("highest", "mixture"):
        found = run_checks(Sampler(channel), material("plane"), only=("samples-pdf",))
        assert found and all(f.ok for f in found), [f.line() for f in found if not f.ok]


def test_a_renderer_meets_the_same_conditions():
    m = material("textured")
    uv = torch.rand(64, 2, generator=rng(9)) * 3 - 1
    wi = 0.5 * square_to_disk(torch.rand(64, 2, generator=rng(10)))
    columns = [mi.Float(v.contiguous().numpy()) for v in (*uv.T, *wi.T)]
    si = SimpleNamespace(uv=mi.Point2f(*columns[:2]), wi=mi.Vector3f(*columns[2:], 1))
    found = m.condition_columns(si)
    rows = torch.cat([m.places(uv), wi], 1)
    for column, expected in zip(found, rows.T, strict=True):
        torch.testing.assert_close(torch.tensor(column.numpy()), expected, rtol=1e-4, atol=1e-5)


def test_renders_by_all_samplers_agree():
    """The same picture by the brightest channel's flow, by all channels', and by a cosine lobe."""
    m, spp = material("textured"), 32
    scene = scenes.make("studio-sphere")
    methods = [Sampler("highest"), Sampler("mixture"), Cosine()]
    for method in methods:
        method.bind(m)
    made = [prepare(scene, m, method, 16, "mis") for method in methods]
    renders = [p.render(spp, seed) for seed, p in enumerate(made)]
    noise = [r.variance / spp for r in renders]
    found = agreement([r.mean for r in renders], noise, made[0].mask)
    assert min(a.p_value for a in found) > 1e-4 / len(found)
    brighter = agreement([renders[0].mean * 1.2, renders[1].mean], noise[:2], made[0].mask)
    assert brighter[0].p_value < 1e-3


# --- files -----------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_a_stored_material_is_the_same(tmp_path, form):
    file = tmp_path / "a.safetensors"
    storage.save(file, network(form), {"name": "a", "about": "x"})
    spec = {"name": "other", "type": "puresample", "file": "a.safetensors"}
    made = registry.make(spec, tmp_path)
    assert made.record == {"name": "a", "about": "x"}
    identity = registry.identity(spec, tmp_path)
    assert made.identity() == identity and str(tmp_path) not in json.dumps(identity)
    condition, wo = made.conditions(50, rng(11)), 0.5 * torch.rand(50, 2, generator=rng(12))
    if form == "textured":  # the texture is rounded to half precision
        torch.testing.assert_close(
            made.network.texture, network(form).texture, rtol=1e-3, atol=1e-4
        )
    else:
        assert torch.equal(made.eval(condition, wo), material(form).eval(condition, wo))
    storage.save(file, network(form, seed=2), {"name": "a"})
    assert registry.identity(spec, tmp_path) != identity


def test_the_record_is_no_part_of_the_identity(tmp_path):
    found = []
    for name in ("a", "b"):
        storage.save(tmp_path / f"{name}.safetensors", network("plane"), {"name": name})
        found.append(files.identity(tmp_path / f"{name}.safetensors", "x"))
    assert found[0] == found[1]


def test_files_of_another_kind_are_refused_in_one_line(tmp_path):
    from harness.materials.neural import files as neural

    leather = neural.shipped()["leather"]
    ours = tmp_path / "ours.safetensors"
    storage.save(ours, network("plane"), {})
    cases = [
        ({"type": "puresample", "file": str(leather)}, "neural-material 1.*expected 'puresample"),
        ({"type": "neural", "file": str(ours)}, "puresample-material 1.*expected 'neural-"),
        ({"type": "puresample", "file": "missing.safetensors"}, "no such file: missing"),
        ({"type": "puresample", "file": "a.ckpt"}, "expected .safetensors, got 'a.ckpt'"),
        ({"type": "puresample"}, "unknown material learned from walks 'x'"),
        ({"type": "puresample", "fil": "a"}, "fil"),
    ]
    for spec, message in cases:
        with pytest.raises(InputError, match=message) as refused:
            registry.validate({"name": "x", **spec}, tmp_path)
        assert "\n" not in str(refused.value)


def test_damaged_tensors_are_refused(tmp_path):
    from safetensors.torch import load_file, save_file

    file = tmp_path / "a.safetensors"
    storage.save(file, network("plane"), {})
    state, meta = load_file(file), storage.metadata(file)
    key = "density.velocity.layers.0.weight"
    damages = [
        ({k: v for k, v in state.items() if k != key}, f"has no tensor '{key}'"),
        ({**state, "more": torch.zeros(1)}, "'more' is none of its sizes'"),
        ({**state, key: state[key][:3].clone()}, "expected \\[12"),
        ({**state, key: state[key] * math.nan}, "not finite"),
    ]
    for tensors, message in damages:
        save_file(tensors, file, metadata=meta)
        with pytest.raises(InputError, match=message):
            storage.load(file)
    for change, message in (
        ({"width": 0}, "width: expected 1"),
        ({"widht": 3}, "widht.*width"),
        ({"domain": "sphere"}, "domain"),
        ({"channels": 3}, "both of resolution and channels"),
        ({"steps": 2.5}, "steps: expected int"),
    ):
        sizes = json.dumps({**SMALL.as_dict(), **change})
        save_file(state, file, metadata={**meta, "architecture": sizes})
        with pytest.raises(InputError, match=message):
            storage.load(file)
