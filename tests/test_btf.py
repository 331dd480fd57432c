"""Measured BTFs: the file format, the interpolation, and what is refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials import registry
from harness.microgeometry import descriptions
from harness.microgeometry.btf_file import COLOUR_MODELS, EPSILON, read
from harness.microgeometry.measured import Directions
from harness.microgeometry.queries import draw, truth

WIDTH, HEIGHT = 6, 4


def dome() -> np.ndarray:
    """Polar and azimuth angles [13, 2]: the normal and two rings, out to 75 degrees."""
    rings = [(0.0, 1), (0.6, 4), (np.radians(75), 8)]
    return np.array([(p, 2 * np.pi * k / n) for p, n in rings for k in range(n)], np.float32)


def disk(angles: np.ndarray) -> np.ndarray:
    return np.sin(angles[:, :1]) * np.stack([np.cos(angles[:, 1]), np.sin(angles[:, 1])], 1)


def header(signature: str, angles: np.ndarray, cosine: int = 0, lamps: np.ndarray | None = None):
    names = b"".join(struct.pack("<I", 1) + c for c in (b"R", b"G", b"B"))
    rest = bytes(240) + struct.pack("<4f", 5, 1, 1, 1) + struct.pack("<I", cosine)
    rest += struct.pack("<I", 3) + b"<a>" + struct.pack("<I", 3) + names
    data = signature.encode() + struct.pack("<2I", len(rest) + 8, 4) + rest
    lamps = angles if lamps is None else lamps
    data += struct.pack("<I", len(angles))
    for view in angles:
        data += view.tobytes() + struct.pack("<I", len(lamps)) + lamps.tobytes()
    data += struct.pack("<2I", WIDTH, HEIGHT)
    return data + (struct.pack("<I", 0) if signature.endswith("R") else b"")


def factored(matrix: np.ndarray, dtype: str = "f4") -> bytes:
    """The full factorisation of ``matrix``, with its sizes."""
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    head = struct.pack("<B3I", np.dtype(dtype).itemsize, len(s), *matrix.shape)
    return head + b"".join(x.astype(f"<{dtype}").tobytes() for x in (s, u, (s[:, None] * vt).T))


def dfmf(path: Path, values: np.ndarray, model: int = 0, turned: bool = False, **more) -> Path:
    """A decorrelated file of channel values [directions, texels, 3]."""
    data = header("!DFMF08FCR", dome(), **more) + struct.pack("<Ii", 99, model)
    data += np.array([0.1, 0.2, 0.3], "<f4").tobytes()
    data += np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], "<f4").tobytes()
    for c in range(3):
        matrix = values[..., c]
        data += factored(matrix.T if turned else matrix)
    path.write_bytes(data)
    return path


def random_values(seed: int = 0) -> np.ndarray:
    n = len(dome()) ** 2
    return np.random.default_rng(seed).uniform(0.1, 1, (n, WIDTH * HEIGHT, 3)).astype(np.float32)


def texel_centres() -> torch.Tensor:
    """Places [H W, 2] in the order of the texels."""
    y, x = np.meshgrid(np.arange(HEIGHT), np.arange(WIDTH), indexing="ij")
    return torch.tensor(np.stack([x.ravel() + 0.5, y.ravel() + 0.5], 1) / WIDTH).float()


def at_measured(surface, light: int, view: int, samples: int = 1) -> torch.Tensor:
    """Answers [H W, 3] at all texels for two measured directions."""
    n = WIDTH * HEIGHT
    wi, wo = (torch.tensor(disk(dome())[k]).float().expand(n, 2) for k in (view, light))
    return truth(surface, texel_centres(), torch.zeros(n), wi, wo, samples, seed=0)


@pytest.mark.parametrize("turned", [False, True])
def test_measured_directions_and_texels_are_given_back(tmp_path, turned):
    values = random_values()
    surface = descriptions.load(dfmf(tmp_path / "a.btf", values, turned=turned))
    for light, view in ((0, 0), (3, 7), (12, 2)):
        expected = values[light + len(dome()) * view]
        found = at_measured(surface, light, view)
        np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize("signature", ["!FMF06FC", "!FMF06FCR", "!FMF12FCER"])
@pytest.mark.parametrize("turned", [False, True])
def test_one_matrix_for_all_channels(tmp_path, signature, turned):
    """The channel runs fastest along the rows, be they directions or texels."""
    values = random_values(1)
    n, m, _ = values.shape
    matrix = values.transpose(1, 2, 0).reshape(3 * m, n)
    if not turned:
        matrix = values.transpose(0, 2, 1).reshape(3 * n, m)
    data = header(signature, dome())
    data += b"\0" if signature == "!FMF12FCER" else b""
    path = tmp_path / "a.btf"
    path.write_bytes(data + struct.pack("<I", 5) + factored(matrix))
    found = at_measured(descriptions.load(path), 4, 9)
    np.testing.assert_allclose(found, values[4 + len(dome()) * 9], rtol=1e-3, atol=1e-4)


def test_half_precision_logarithms_and_heights_are_read(tmp_path):
    values = random_values(2)
    n, m, _ = values.shape
    matrix = np.log(values + EPSILON).transpose(0, 2, 1).reshape(3 * n, m)
    data = header("!FMF12FCER", dome()) + struct.pack("<BI2I", 2, 1, 2, 3) + bytes(12)
    path = tmp_path / "a.btf"
    path.write_bytes(data + struct.pack("<I", 5) + factored(matrix, "f2"))
    found = at_measured(descriptions.load(path), 4, 9)
    np.testing.assert_allclose(found, values[4 + len(dome()) * 9], rtol=0.05)


@pytest.mark.parametrize("model", [m for m in COLOUR_MODELS if m])
def test_colour_models_are_undone(tmp_path, model):
    """Against the definition of each model, applied to known colours."""
    rgb = random_values(3).astype(np.float64)
    y = rgb @ [0.299, 0.587, 0.114]
    yuv = np.stack([y, (rgb[..., 2] - y) / 2.03211, (rgb[..., 0] - y) / 1.13983], -1)
    co = (rgb[..., 0] - rgb[..., 2]) / 2
    middle = rgb[..., 2] + co
    cg = (rgb[..., 1] - middle) / 2
    coded = {
        1: yuv,
        3: (rgb - [0.1, 0.2, 0.3]) @ np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]).T,
        4: np.stack([middle + cg, co, cg], -1),
        9: np.concatenate([np.log(yuv[..., :1] + EPSILON), yuv[..., 1:]], -1),
        11: np.concatenate(
            [np.log(yuv[..., :1] + EPSILON), yuv[..., 1:] / (yuv[..., :1] + EPSILON)], -1
        ),
        12: np.log(rgb + EPSILON),
    }[model]
    path = dfmf(tmp_path / "a.btf", coded.astype(np.float32), model)
    found = at_measured(descriptions.load(path), 2, 5)
    np.testing.assert_allclose(found, rgb[2 + len(dome()) * 5], rtol=5e-3, atol=1e-3)


def test_a_linear_function_of_directions_is_interpolated_exactly(tmp_path):
    """Inside the measured cone; beyond it the value of the rim is kept."""
    w = disk(dome())
    light, view = np.meshgrid(np.arange(13), np.arange(13))  # light runs fastest
    f = 1 + w[light.ravel(), 0] + 0.5 * w[view.ravel(), 1]
    values = np.tile(f[:, None, None], (1, WIDTH * HEIGHT, 3)).astype(np.float32)
    surface = descriptions.load(dfmf(tmp_path / "a.btf", values))
    random = torch.rand(500, 4, generator=torch.Generator().manual_seed(1)) - 0.5
    wi, wo = random[:, :2], random[:, 2:]
    found = truth(surface, torch.zeros(500, 2), torch.zeros(500), wi, wo, 1, 0)[:, 0]
    torch.testing.assert_close(found, 1 + wo[:, 0] + 0.5 * wi[:, 1], rtol=1e-4, atol=1e-4)
    out = torch.tensor([[0.999, 0.0]])
    rim = truth(surface, torch.zeros(1, 2), torch.zeros(1), torch.zeros(1, 2), out, 1, 0)
    assert float(rim[0, 0]) == pytest.approx(1 + np.sin(np.radians(75)), abs=1e-4)


def test_weights_are_those_of_a_point_between_its_corners():
    directions = Directions(np.concatenate([disk(dome()), np.ones((13, 1))], 1), "views")
    w = 0.9 * disk(dome()).repeat(5, 0)[::3]
    index, weight = directions.weights(w)
    assert (weight > -1e-6).all()
    np.testing.assert_allclose(weight.sum(1), 1, rtol=1e-6)
    np.testing.assert_allclose(np.einsum("ni,nij->nj", weight, disk(dome())[index]), w, atol=1e-6)


def test_the_cosine_in_the_data_is_divided_out(tmp_path):
    values = random_values(4)
    surface = descriptions.load(dfmf(tmp_path / "a.btf", values, cosine=1))
    expected = values[12 + len(dome()) * 3] / np.cos(dome()[12, 0])
    np.testing.assert_allclose(at_measured(surface, 12, 3), expected, rtol=5e-4, atol=1e-4)


def test_a_large_footprint_is_the_mean_of_the_picture(tmp_path):
    values = random_values(5)
    surface = descriptions.load(dfmf(tmp_path / "a.btf", values))
    n, zero = 400, torch.zeros(400, 2)
    f = truth(surface, zero, torch.full((n,), 3.0), zero, zero, samples=16, seed=1)
    spread = f.std(0) / n**0.5
    assert ((f.mean(0) - torch.tensor(values[0].mean(0))).abs() < 4 * spread).all()


def test_queries_are_drawn_from_it_as_from_any_surface(tmp_path):
    path = dfmf(tmp_path / "carpet.btf", random_values())
    surface = descriptions.load(path)
    q = draw(surface, 100, seed=1, kernel=0.1)
    assert torch.equal(q.f, draw(surface, 100, seed=1, kernel=0.1).f)
    part = truth(surface, *(x[:7] for x in q[:4]), samples=2, seed=1)
    torch.testing.assert_close(part, q.f[:7])
    assert surface.name == "carpet" and surface.identity()["type"] == "btf"
    with pytest.raises(InputError, match="measured at its own resolution"):
        descriptions.load(path, resolution=64)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: b"!PVF06FCR" + d[9:], "expected a BTF that begins with !DFMF08FCR"),
        (lambda d: d[:-3], "bytes; expected more"),
        (lambda d: d[:10] + struct.pack("<I", 7) + d[14:], "meta data of"),
        (
            lambda d: d.replace(struct.pack("<Ii", 99, 0), struct.pack("<Ii", 99, 2)),
            "colour model 2",
        ),
        (lambda d: d.replace(struct.pack("<2I", 6, 4), struct.pack("<2I", 5, 4)), "factors of 169"),
        (
            lambda d: d.replace(struct.pack("<3I", 6, 4, 0), struct.pack("<3I", 6, 4, 1)),
            "local frames",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, spoil, message):
    path = dfmf(tmp_path / "a.btf", random_values())
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_directions_on_one_side_are_refused(tmp_path):
    lamps = np.array([[0.5, 0.0], [0.8, 0.1], [0.8, -0.1]], np.float32)
    path = tmp_path / "a.btf"
    values = random_values()[: 13 * 3]
    data = header("!DFMF08FCR", dome(), lamps=lamps) + struct.pack("<Ii", 9, 0) + bytes(48)
    path.write_bytes(data + b"".join(factored(values[..., c]) for c in range(3)))
    with pytest.raises(InputError, match="lights: expected directions all around the normal"):
        descriptions.load(path)


# --- as a material ---------------------------------------------------------------------


def test_it_is_a_material_of_a_suite(tmp_path):
    """Addressed by uv, seen by its leading factors; its density is drawn from as any other's."""
    dfmf(tmp_path / "carpet.btf", random_values())
    spec = {"name": "carpet", "type": "btf", "file": "carpet.btf"}
    material = registry.make(spec, tmp_path)
    assert (material.n_address, material.n_features) == (2, 8)
    condition = material.conditions(50, torch.Generator().manual_seed(0))
    wo = square_to_disk(torch.rand(50, 2, generator=torch.Generator().manual_seed(1)))
    expected = truth(
        material.surface, condition[:, :2], torch.zeros(50), condition[:, -2:], wo, 1, 0
    )
    assert torch.equal(material.eval(condition, wo), expected)
    assert (material.eval(condition, wo / wo.norm(dim=1, keepdim=True) * 1.01) == 0).all()
    table = material.places(texel_centres())[:, 2:]
    torch.testing.assert_close(table.mean(0), torch.zeros(8), rtol=0, atol=1e-5)
    assert registry.identity(spec, tmp_path) == material.identity()
    again = registry.identity({**spec, "name": "other"}, tmp_path)
    assert again == material.identity() and str(tmp_path) not in str(again)


def test_a_suite_s_bad_file_is_refused_with_the_material_s_name(tmp_path):
    spec = {"name": "carpet", "type": "btf", "file": "carpet.btf"}
    with pytest.raises(InputError, match="material 'carpet': .*cannot be read"):
        registry.validate(spec, tmp_path)
    (tmp_path / "carpet.btf").write_bytes(b"!BDIF06R2!....")
    with pytest.raises(InputError, match="material 'carpet': .*begins with"):
        registry.validate(spec, tmp_path)
