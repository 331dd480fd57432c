"""The files that people have, each against an evaluation that shares no code with the reader."""

from __future__ import annotations

import math
import struct
import sys

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import square_to_disk, to_direction
from harness.core.protocol.errors import InputError
from harness.materials import measured, nbrdf
from harness.materials import registry as materials
from harness.scenes import registry as scenes
from harness.scenes.named_files import named_files

RNG = np.random.default_rng(11)


def pairs(n=400, seed=5):
    """Random ``(condition [n, 2], wo [n, 2])``."""
    u = torch.rand(n, 4, generator=torch.Generator().manual_seed(seed))
    return square_to_disk(u[:, :2]), square_to_disk(u[:, 2:])


def rotated(v, axis, angle):
    """A vector turned about an axis (Rodrigues), plain numpy."""
    c, s = math.cos(angle), math.sin(angle)
    return c * v + s * np.cross(axis, v) + (1 - c) * np.dot(axis, v) * axis


def half_difference(light, view):
    """Half and difference vector of two directions, one pair at a time, in double precision."""
    half = (light + view) / np.linalg.norm(light + view)
    theta, phi = math.acos(min(half[2], 1.0)), math.atan2(half[1], half[0])
    turned = rotated(light, np.array([0.0, 0, 1]), -phi)
    return half, rotated(turned, np.array([0.0, 1, 0]), -theta)


def evaluated(material, function, n=400):
    """The material and ``function(light, view)`` at the same random pairs: two arrays [n, 3]."""
    condition, wo = pairs(n)
    view, light = (to_direction(v.double()).numpy() for v in (condition, wo))
    expected = np.array([function(a, b) for a, b in zip(light, view, strict=True)])
    return material.eval(condition, wo).numpy(), expected


# --- MERL ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def merl(tmp_path_factory):
    """A table of random numbers, some below zero; its values, and the file."""
    values = RNG.uniform(-1, 50, (3, 90, 90, 180))
    file = tmp_path_factory.mktemp("merl") / "noise.binary"
    file.write_bytes(struct.pack("<3i", 90, 90, 180) + values.astype("<f8").tobytes())
    return values, file


def test_merl(merl):
    """The database's own lookup: the cell, times the scale of its channel."""
    values, file = merl
    material = materials.make({"name": "m", "type": "merl", "file": file.name}, file.parent)

    def lookup(light, view):
        half, diff = half_difference(light, view)
        theta_h, theta_d = math.acos(min(half[2], 1)), math.acos(min(diff[2], 1))
        phi_d = math.atan2(diff[1], diff[0])
        phi_d += math.pi if phi_d < 0 else 0
        degrees = math.degrees(theta_h)
        i = min(int(math.sqrt(degrees * 90)), 89)
        j = min(int(math.degrees(theta_d)), 89)
        k = min(int(math.degrees(phi_d)), 179)
        scales = (1 / 1500, 1.15 / 1500, 1.66 / 1500)
        return [scales[c] * values[c, i, j, k] for c in range(3)]

    found, expected = evaluated(material, lookup)
    same = np.isclose(found, expected, rtol=1e-5).all(1)
    # In single precision a pair at the edge of a cell falls into the next one.
    assert same.mean() > 0.98
    assert (found < 0).any() and material.n_condition == 2
    condition, wo = pairs()
    back = material.eval(wo, condition).numpy()
    assert (np.isclose(found, back, rtol=1e-5).all(1)).mean() > 0.95  # reciprocal
    assert (material.eval(condition, 3 * wo / wo.norm(dim=1, keepdim=True)) == 0).all()
    assert named_files({"name": "m", "type": "merl", "file": str(file)}) == [file.resolve()]


def test_merl_is_rendered(merl):
    """By Dr.Jit alone; by the cosine and by a uniform disk, the same image."""
    from harness.core import registry
    from harness.mitsuba_runtime.variant import use

    use("cpu")
    from harness.rendering.prepared import prepare
    from tests.render_subjects import UniformDisk

    _, file = merl
    material = materials.make({"name": "m", "type": "merl", "file": file.name}, file.parent)
    means = []
    for method in (registry.make("cosine"), UniformDisk()):
        method.bind(material)
        ready = prepare(scenes.make("uniform-sphere"), material, method, 12)
        done = ready.render(128, 0)
        error = done.error(ready.mask) / 128 / ready.mask.sum()
        means.append((done.mean[ready.mask].mean(), error))
    (a, s), (b, t) = means
    assert abs(a - b) < 5 * math.sqrt(s + t) + 1e-4


# --- UTIA ------------------------------------------------------------------------------


def test_utia(tmp_path):
    """Linear in four angles; a measured direction is given back as it is."""
    values = RNG.uniform(-0.01, 1, (3, 288, 288))
    (tmp_path / "m.bin").write_bytes(values.astype("<f8").tobytes())
    spec = {"name": "m", "type": "utia", "file": "m.bin"}
    material = materials.make(spec, tmp_path)

    def around(v):
        theta = math.degrees(math.acos(min(v[2], 1))) / 15
        phi = math.degrees(math.atan2(v[1], v[0])) % 360 / 7.5
        i, j = min(int(theta), 4), int(phi) % 48
        s, t = theta - i, phi - int(phi)
        rows = ((i, 1 - s), (i + 1, s))
        columns = ((j, 1 - t), ((j + 1) % 48, t))
        return [(48 * r + c, a * b) for r, a in rows for c, b in columns]

    def lookup(light, view):
        return sum(a * b * values[:, m, n] for m, a in around(light) for n, b in around(view))

    found, expected = evaluated(material, lookup)
    assert found == pytest.approx(expected, abs=2e-4)
    theta, phi = math.radians(45), math.radians(7.5 * 13)
    place = torch.tensor([[math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi)]])
    at = material.eval(place.float(), torch.tensor([[math.sin(math.radians(30)), 0.0]]))
    assert at[0].numpy() == pytest.approx(values[:, 48 * 2, 48 * 3 + 13], abs=1e-4)
    half = materials.make(spec | {"scale": 0.5}, tmp_path)
    c, wo = pairs(20)
    assert torch.allclose(half.eval(c, wo), 0.5 * material.eval(c, wo), atol=1e-5)
    assert half.identity() != material.identity()
    with pytest.raises(InputError, match="scale: expected a number above 0"):
        materials.validate(spec | {"scale": -1}, tmp_path)


# --- Sztrajman et al. ------------------------------------------------------------------


def network(folder, name="red_"):
    """Six files of a random network."""
    arrays = {k: 0.4 * RNG.normal(size=s).astype(np.float32) for k, s in nbrdf.SHAPES.items()}
    for key, array in arrays.items():
        np.save(folder / f"{name}{key}.npy", array)
    return arrays


def test_nbrdf(tmp_path):
    """The network in torch, in double precision, of half and difference vector."""
    arrays = network(tmp_path)
    spec = {"name": "m", "type": "nbrdf", "file": "red_fc1.npy"}
    material = materials.make(spec, tmp_path)
    w = {k: torch.from_numpy(v).double() for k, v in arrays.items()}

    def lookup(light, view):
        half, diff = half_difference(light, view)
        x = torch.tensor([math.hypot(half[0], half[1]), 0, half[2], *diff], dtype=torch.float64)
        x = torch.relu(x @ w["fc1"] + w["b1"])
        x = torch.relu(x @ w["fc2"] + w["b2"])
        return torch.relu(torch.exp(x @ w["fc3"] + w["b3"]) - 1).numpy()

    found, expected = evaluated(material, lookup)
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-4) and (found > 0).any()
    assert len(named_files(spec, tmp_path)) == 6
    before = material.identity()
    np.save(tmp_path / "red_b3.npy", arrays["b3"] + 1)
    assert materials.identity(spec, tmp_path) != before


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda f: (f / "red_b2.npy").unlink(), "cannot be read"),
        (lambda f: np.save(f / "red_b2.npy", np.zeros(3, np.float32)), r"shape \[21\], got fl"),
        (lambda f: np.save(f / "red_b2.npy", np.array([{}]), allow_pickle=True), "got object of"),
        (lambda f: (f / "red_b2.npy").write_bytes(b"\x93NUMPY"), "no array of"),
    ],
)
def test_nbrdf_refusals(tmp_path, spoil, said):
    """What is missing, misshapen or pickled; nothing is executed."""
    network(tmp_path)
    spoil(tmp_path)
    with pytest.raises(InputError, match=said):
        materials.validate({"name": "m", "type": "nbrdf", "file": "red_fc1.npy"}, tmp_path)


def keras(path, arrays, form="{}/{}", model="model_weights/"):
    """The same network as Keras 2 or 3 writes it, with what else such files hold."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.attrs["model_config"] = "{}"
        file["optimizer_weights/iterations"] = np.int64(3)
        for i in (1, 2, 3):
            layer = model + form.format("dense", "kernel:0").replace("dense", f"dense_{i}")
            other = model + form.format("dense", "bias:0").replace("dense", f"dense_{i}")
            file[layer], file[other] = arrays[f"fc{i}"], arrays[f"b{i}"]


@pytest.mark.parametrize(
    ("form", "model"), [("{0}/{0}/{1}", "model_weights/"), ("{0}/{1}", ""), ("{0}/vars/{1}", "l/")]
)
def test_nbrdf_of_keras(tmp_path, form, model):
    """Is the network of the six arrays, and counts by content."""
    arrays = network(tmp_path)
    keras(tmp_path / "red.h5", arrays, form, model)
    plain = materials.make({"name": "m", "type": "nbrdf", "file": "red_fc1.npy"}, tmp_path)
    spec = {"name": "m", "type": "nbrdf", "file": "red.h5"}
    material = materials.make(spec, tmp_path)
    condition = plain.conditions(64, torch.Generator().manual_seed(1))
    wo = 0.5 * condition
    assert torch.equal(material.eval(condition, wo), plain.eval(condition, wo))
    assert [path.name for path in named_files(spec, tmp_path)] == ["red.h5"]
    before = material.identity()
    keras(tmp_path / "red.h5", arrays | {"b3": arrays["b3"] + 1}, form, model)
    assert materials.identity(spec, tmp_path) != before


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda f, a: f.write_bytes(b"\x89HDF\r\n\x1a\n"), "no HDF5 file that can be read"),
        (lambda f, a: keras(f, a | {"fc2": np.zeros((3, 3), "f")}), r"\[21, 21\] .* found 0"),
        (lambda f, a: keras(f, {k: np.zeros(v.shape, "S4") for k, v in a.items()}), "found 0"),
    ],
)
def test_nbrdf_of_keras_refusals(tmp_path, spoil, said):
    spoil(tmp_path / "red.h5", network(tmp_path))
    with pytest.raises(InputError, match=said):
        materials.validate({"name": "m", "type": "nbrdf", "file": "red.h5"}, tmp_path)


def test_nbrdf_of_keras_without_h5py(tmp_path, monkeypatch):
    (tmp_path / "red.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(InputError, match="needs the package h5py"):
        materials.validate({"name": "m", "type": "nbrdf", "file": "red.h5"}, tmp_path)


# --- RGL with spectra ------------------------------------------------------------------


def test_spectra_of_the_rgl_database(tmp_path):
    """As the same file with the colours that Mitsuba makes of each spectrum."""
    from harness.mitsuba_runtime.variant import use

    mi = use("cpu")
    grid = np.array([400.0, 480, 520, 560, 640, 700], np.float32)
    # Not too colourful: Mitsuba's own spectra are cut off at 0 and 1 in every channel.
    spectra = RNG.uniform(0.4, 0.8, (1, 4, 6, 8, 8)).astype(np.float32)
    rgb = np.empty((1, 4, 3, 8, 8), np.float32)
    for i in np.ndindex(4, 8, 8):
        row = spectra[0, i[0], :, i[1], i[2]]
        pairs_ = [(float(w), float(v)) for w, v in zip(grid, row, strict=True)]
        value = mi.load_dict({"type": "spectrum", "value": pairs_})
        rgb[0, i[0], :, i[1], i[2]] = np.ravel(mi.traverse(value)["value"])
    shared = {
        "description": np.frombuffer(b"a test", np.uint8),
        "phi_i": np.zeros(1),
        "theta_i": np.linspace(0, np.pi / 2, 4),
        "ndf": np.ones((8, 8)),
        "sigma": np.ones((8, 8)),
        "vndf": RNG.uniform(0.5, 1, (1, 4, 8, 8)),
        "luminance": RNG.uniform(0.5, 1, (1, 4, 8, 8)),
        "jacobian": np.zeros(1, np.uint8),
    }
    (tmp_path / "spec.bsdf").write_bytes(
        measured.written(shared | {"spectra": spectra, "wavelengths": grid})
    )
    (tmp_path / "rgb.bsdf").write_bytes(measured.written(shared | {"rgb": rgb}))
    a, b = (
        materials.make({"name": "m", "type": "measured", "file": f"{kind}.bsdf"}, tmp_path)
        for kind in ("spec", "rgb")
    )
    condition, wo = pairs(300)
    found = a.eval(condition, wo)
    assert torch.allclose(found, b.eval(condition, wo), rtol=1e-3, atol=1e-4)
    assert (found > 0).any(1).double().mean() > 0.5


# --- others ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "content", "said"),
    [
        ("measured", struct.pack("<3i", 90, 90, 180) + bytes(800), "type: merl"),
        ("merl", struct.pack("<3i", 90, 90, 180) + bytes(800), "cut short or longer: 812 bytes"),
        ("merl", b"tensor_file\0\1\0", "type: measured"),
        ("merl", b"", "does not begin with 90, 90, 180"),
        ("utia", b"!FMF06FC" + bytes(100), "type: btf"),
        ("utia", b"abc", "it has 3 bytes, expected 1990656"),
        ("measured", bytes(1990656), "type: utia"),
        ("measured", b"\x89HDF\r\n\x1a\n", "HDF5"),
        ("nbrdf", b"\x89HDF\r\n\x1a\n", "HDF5"),
        ("btf", b"\x76\x2f\x31\x01", "OpenEXR"),
        ("btf", struct.pack("<3i", 90, 90, 180), "type: merl"),
    ],
)
def test_a_file_of_another_kind(tmp_path, kind, content, said):
    """Is refused by its name, with the type to give instead."""
    (tmp_path / "file.dat").write_bytes(content)
    with pytest.raises(InputError, match=said) as refused:
        materials.validate({"name": "m", "type": kind, "file": "file.dat"}, tmp_path)
    assert "\n" not in str(refused.value)


def test_every_kind_has_its_file():
    """A file of the folder is all that it takes."""
    kinds = {"btf", "family", "hard", "measured", "merl", "mitsuba", "nbrdf", "neural", "utia"}
    assert set(materials.KINDS) >= kinds
    with pytest.raises(InputError, match="did you mean 'merl'"):
        materials.validate({"name": "m", "type": "merrl"})


# --- environments ----------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["exr", "hdr"])
def test_an_environment_of_ones_own(tmp_path, suffix):
    """The image is that of Mitsuba's envmap of the same file, whichever way is up."""
    from harness.core import registry
    from harness.mitsuba_runtime.variant import use

    mi = use("cpu")
    from harness.rendering.prepared import prepare, prepare_native

    picture = RNG.uniform(0.1, 1, (16, 32, 3)).astype(np.float32)
    picture[3:6, 5:9] = (20, 15, 5)
    mi.Bitmap(picture).write(str(tmp_path / f"sky.{suffix}"))
    spec = {"name": "out", "scene": "studio-sphere", "environment": f"sky.{suffix}"}
    scene = scenes.make(spec, tmp_path)
    assert scene.environment == pytest.approx(picture, rel=0.02, abs=0.2)
    material = materials.make({"name": "m", "type": "mitsuba", "bsdf": {"type": "diffuse"}})
    method = registry.make("cosine")
    method.bind(material)
    ready = prepare(scene, material, method, 16)
    done = ready.render(256, 0)
    theirs = prepare_native(scene, material, 16)
    description = {
        "type": "scene", "sensor": theirs.scene.sensors()[0],
        "shape": theirs.scene.shapes()[0],
        "light": {"type": "envmap", "filename": str(tmp_path / f"sky.{suffix}")},
    }  # fmt: skip
    image = theirs.integrator.render(mi.load_dict(description), seed=1, spp=256)
    luminance = np.array(image)[..., 4]
    error = math.sqrt(2 * done.error(ready.mask) / 256 / ready.mask.sum())
    found, expected = done.mean[ready.mask].mean(), luminance[ready.mask].mean()
    assert found == pytest.approx(expected, abs=5 * error)
    before = scenes.identity(spec, tmp_path)
    assert named_files(spec, tmp_path) == [(tmp_path / f"sky.{suffix}").resolve()]
    mi.Bitmap(picture + 1).write(str(tmp_path / f"sky.{suffix}"))
    assert scenes.identity(spec, tmp_path) != before


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ({"environment": "sky.png"}, "expected a picture in .exr"),
        ({"environment": "sky.exr"}, "no such file"),
        ({"environment": "bad.exr"}, "cannot be read"),
        ({"environment": "nan.exr"}, "no radiance"),
        ({"environment": 3}, "expected the name of a picture"),
        ({"scene": "shelf", "environment": "nan.exr"}, "the scene's effects leave it out"),
    ],
)
def test_environment_refusals(tmp_path, spec, said):
    """One line each."""
    import mitsuba as mi

    (tmp_path / "bad.exr").write_bytes(b"\x76\x2f\x31\x01 not more")
    mi.Bitmap(np.full((4, 8, 3), np.nan, np.float32)).write(str(tmp_path / "nan.exr"))
    with pytest.raises(InputError, match=said):
        scenes.make({"name": "s", "scene": "studio-sphere"} | spec, tmp_path)
