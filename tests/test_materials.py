"""The materials: named, measured, by dictionary and by XML, and what is refused."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials import registry
from harness.textures import maps, noise, patterns

PAINT = {"type": "principled", "base_color": [0.5, 0.2, 0.1], "roughness": 1}
XML = """<scene version="3.0.0">
  <default name="a" value="0.2"/>
  <texture type="checkerboard" id="squares"/>
  <bsdf type="roughplastic" id="shiny"><float name="alpha" value="$a"/></bsdf>
  <bsdf type="diffuse" id="board"><ref name="reflectance" id="squares"/></bsdf>
  <shape type="sphere"><ref id="shiny"/></shape>
</scene>"""


def tensor_file(fields: dict[str, np.ndarray]) -> bytes:
    """A tensor file of float32 fields."""
    head = b"tensor_file\0\1\0" + struct.pack("<I", len(fields))
    at = len(head) + sum(2 + len(n) + 11 + 8 * a.ndim for n, a in fields.items())
    data = b""
    for name, array in fields.items():
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack(f"<HBQ{array.ndim}Q", array.ndim, 10, at + len(data), *array.shape)
        data += array.astype("<f4").tobytes()
    return head + data


def measured_fields() -> dict[str, np.ndarray]:
    """A small isotropic measured material: a Lambertian in the file's parameters."""
    incident = np.linspace(0, np.pi / 2, 4)
    full = (1, 4, 8, 8)
    return {
        "description": np.zeros(4),
        "phi_i": np.zeros(1),
        "theta_i": incident,
        "ndf": np.ones((8, 8)),
        "sigma": np.ones((8, 8)),
        "vndf": np.ones(full),
        "luminance": np.ones(full),
        "rgb": np.ones((1, 4, 3, 8, 8)) * np.array([0.5, -0.1, 0.2])[:, None, None],
        "jacobian": np.zeros(1),
    }


# --- textures --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "field",
    [
        lambda: noise.fbm(64, (4, 3), seed=1, octaves=2),
        lambda: noise.fbm(64, (2, 4), seed=2, octaves=2, ridged=True),
        lambda: noise.cellular(64, (4, 5), seed=3).nearest,
        lambda: noise.cellular(64, (4, 5), seed=3).border,
        lambda: noise.blur(np.random.default_rng(0).random((64, 64)), 3.0),
    ],
    ids=["fbm", "ridged", "nearest", "border", "blur"],
)
def test_fields_wrap_around(field):
    """The step across the tile's edge is like the steps within it."""
    x = field()
    for axis in (0, 1):
        steps = np.abs(np.diff(x, axis=axis))
        across = np.abs(x.take(0, axis) - x.take(-1, axis))
        assert across.mean() < 2.5 * steps.mean() and across.max() < 1.5 * steps.max() + 1e-9


def test_fields_are_seeded():
    np.testing.assert_array_equal(noise.fbm(32, (4, 4), seed=5), noise.fbm(32, (4, 4), seed=5))
    assert np.abs(noise.fbm(32, (4, 4), seed=5) - noise.fbm(32, (4, 4), seed=6)).max() > 0.1


def test_cell_border_is_half_way_between_seeds():
    """Without jitter the cells are squares: the border is known in closed form."""
    cells = noise.cellular(64, (4, 4), seed=0, jitter=0.0)
    u, v = noise.grid(64)
    x, y = (4 * u) % 1, (4 * v) % 1
    expected = np.minimum.reduce([x, 1 - x, y, 1 - y])
    np.testing.assert_allclose(cells.border, expected, atol=1e-12)


def test_normals_point_down_the_slope():
    u, v = noise.grid(128)
    height = np.sin(2 * np.pi * u) + np.cos(2 * np.pi * v)
    n = maps.normals(height, 0.01)
    slope_u, slope_v = 0.02 * np.pi * np.cos(2 * np.pi * u), -0.02 * np.pi * np.sin(2 * np.pi * v)
    np.testing.assert_allclose(-n[..., 0] / n[..., 2], slope_u, atol=1e-4)
    np.testing.assert_allclose(-n[..., 1] / n[..., 2], slope_v, atol=1e-4)


def test_panels_cover_the_tile_once():
    _, _, boxes = patterns.panels(64, 0.15, seed=1)
    assert sum((b[2] - b[0]) * (b[3] - b[1]) for b in boxes) == pytest.approx(1)


def test_bitmap_refuses_what_is_no_reflectance():
    with pytest.raises(ValueError, match="outside"):
        maps.bitmap(np.full((4, 4), 1.5))
    with pytest.raises(ValueError, match="outside"):
        maps.bitmap(np.full((4, 4), np.nan))


# --- the named twelve ------------------------------------------------------------------


def test_twelve_are_named():
    assert len(registry.names()) == 12
    assert all("-" not in n or n.replace("-", "").isalpha() for n in registry.names())
    assert all(registry.describe(n) and "\n" not in registry.describe(n) for n in registry.names())


def test_looking_up_loads_no_renderer():
    code = (
        "import sys; from harness.materials import registry as m; from harness.scenes import"
        " registry as s; [m.identity(n) for n in m.names()]; [s.identity(n) for n in s.names()];"
        " sys.exit(any(x in sys.modules for x in ('mitsuba', 'drjit')))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[1])


@pytest.mark.parametrize("name", registry.names())
def test_named_material(name):
    """Finite, not negative, not brighter than white, textured, and not black."""
    generator = torch.Generator().manual_seed(1)
    material = registry.make(name)
    assert material.name == name and material.identity() == registry.identity(name)
    json.dumps(material.identity())
    assert material.n_address == 2 and 1 <= material.n_features <= 8
    condition = material.conditions(64, generator).repeat_interleave(512, 0)
    wo = square_to_disk(torch.rand(len(condition), 2, generator=generator))
    value = material.eval(condition, wo)
    assert torch.isfinite(value).all() and (value >= 0).all()
    albedo = value.view(64, 512, 3).mean(1) * torch.pi
    assert 0.02 < albedo.mean() < 0.9


def test_named_materials_differ_in_difficulty():
    """The variance of cosine sampling, chi-square against the uniform disk, spans the range."""
    generator = torch.Generator().manual_seed(2)

    def difficulty(name: str) -> float:
        material = registry.make(name)
        condition = material.conditions(64, generator).repeat_interleave(1024, 0)
        wo = square_to_disk(torch.rand(len(condition), 2, generator=generator))
        target = material.target(condition, wo).view(64, 1024)
        return ((target / target.mean(1, keepdim=True)).square().mean(1) - 1).median().item()

    assert difficulty("suede") < 0.2
    assert difficulty("brushed-metal") > 3


# --- a user's own ----------------------------------------------------------------------


def test_dictionary():
    material = registry.make({"name": "paint", "type": "mitsuba", "bsdf": PAINT})
    value = material.eval(torch.tensor([[0.1, 0.2]]), torch.tensor([[0.3, 0.0]]))
    assert value[0, 0] > value[0, 1] > value[0, 2] > 0
    other = {"name": "x", "type": "mitsuba", "bsdf": {**PAINT, "roughness": 0.5}}
    assert registry.identity(other) != material.identity()
    assert registry.identity({**other, "name": "y"}) == registry.identity(other)


def test_xml(tmp_path):
    (tmp_path / "s.xml").write_text(XML)
    spec = {"name": "x", "type": "mitsuba", "file": "s.xml", "id": "shiny"}
    material = registry.make(spec, tmp_path)
    same = {"type": "roughplastic", "alpha": 0.2}
    direct = registry.make({"name": "d", "type": "mitsuba", "bsdf": same})
    condition, wo = torch.tensor([[0.1, 0.2]]), torch.tensor([[-0.1, -0.25]])
    assert torch.equal(material.eval(condition, wo), direct.eval(condition, wo))
    board = registry.make({**spec, "id": "board"}, tmp_path)
    assert board.n_address == 2 and board.n_features == 1


def test_xml_identity_is_content(tmp_path):
    for folder, value in (("a", b"1"), ("b", b"1"), ("c", b"2")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "t.png").write_bytes(value)
        (tmp_path / folder / "m.xml").write_text(
            '<bsdf version="3.0.0" type="diffuse"><texture type="bitmap" name="reflectance">'
            '<string name="filename" value="t.png"/></texture></bsdf>'
        )
    spec = {"name": "x", "type": "mitsuba", "file": "m.xml"}
    a, b, c = (registry.identity(spec, tmp_path / f) for f in "abc")
    assert a == b != c and str(tmp_path) not in json.dumps(a)


def test_measured(tmp_path):
    (tmp_path / "m.bsdf").write_bytes(tensor_file(measured_fields()))
    spec = {"name": "m", "type": "measured", "file": "m.bsdf"}
    registry.validate(spec, tmp_path)
    (tmp_path / "n.bsdf").write_bytes((tmp_path / "m.bsdf").read_bytes())
    assert registry.identity(spec, tmp_path) == registry.identity(
        {**spec, "name": "n", "file": str(tmp_path / "n.bsdf")}
    )


# --- what is refused -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("suedde", "unknown material 'suedde'; did you mean 'suede'?"),
        ({"name": "suedde"}, "did you mean 'suede'"),
        (3, "expected a name or a mapping"),
        ({"type": "mitsuba", "bsdf": PAINT}, "name: expected a text"),
        ({"name": "x", "bsdf": PAINT}, "expected the key 'type'"),
        ({"name": "x", "type": "mitsuuba", "bsdf": PAINT}, "did you mean 'mitsuba'"),
        ({"name": "x", "type": ["mitsuba"], "bsdf": PAINT}, "unknown type"),
        ({"name": "x", "type": "mitsuba"}, "expected either 'bsdf' or 'file'"),
        ({"name": "x", "type": "mitsuba", "bsdf": "diffuse"}, "bsdf: expected a mapping"),
        ({"name": "x", "type": "mitsuba", "bsdf": {"alpha": 1}}, "bsdf: expected the key 'type'"),
        (
            {"name": "x", "type": "mitsuba", "bsdf": {"type": "diffuse", "a": float("nan")}},
            "bsdf.a: expected a number",
        ),
        (
            {"name": "x", "type": "mitsuba", "bsdf": {"type": "bitmap", "filename": "no.png"}},
            "bsdf.filename: no such file",
        ),
        ({"name": "x", "type": "mitsuba", "bsdf": PAINT, "fil": 1}, "unknown key 'fil'"),
        ({"name": "x", "type": "measured"}, "file: expected the name of a file"),
        ({"name": "x", "type": "measured", "file": "no.bsdf"}, "no such file"),
        ({"name": "x", "type": "measured", "file": "text.bsdf"}, "does not begin with"),
        ({"name": "x", "type": "measured", "file": "short.bsdf"}, "cut short"),
        ({"name": "x", "type": "measured", "file": "header.bsdf"}, "damaged"),
        ({"name": "x", "type": "measured", "file": "spectra.bsdf"}, "no field 'wavelengths'"),
        ({"name": "x", "type": "measured", "file": "other.bsdf"}, "no field 'ndf'"),
        ({"name": "x", "type": "mitsuba", "file": "no.xml"}, "no such file"),
        ({"name": "x", "type": "mitsuba", "file": "text.bsdf"}, "is not XML"),
        ({"name": "x", "type": "mitsuba", "file": "html.xml"}, "no Mitsuba file"),
        ({"name": "x", "type": "mitsuba", "file": "empty.xml"}, "has no <bsdf>"),
        ({"name": "x", "type": "mitsuba", "file": "s.xml"}, "has 2 BSDFs"),
        (
            {"name": "x", "type": "mitsuba", "file": "s.xml", "id": "shinny"},
            "no BSDF of id 'shinny'; did you mean 'shiny'?",
        ),
        ({"name": "x", "type": "mitsuba", "file": "s.xml", "id": 3}, "id: expected a text"),
    ],
)
def test_refused(spec, message, tmp_path):
    fields = measured_fields()
    whole = tensor_file(fields)
    spectra = {("spectra" if k == "rgb" else k): v for k, v in fields.items()}
    other = {k: v for k, v in fields.items() if k != "ndf"}
    for name, data in {
        "text.bsdf": b"not a measurement",
        "short.bsdf": whole[:-1000],
        "header.bsdf": whole[:60],
        "spectra.bsdf": tensor_file(spectra),
        "other.bsdf": tensor_file(other),
        "html.xml": b"<html/>",
        "empty.xml": b'<scene version="3.0.0"/>',
        "s.xml": XML.encode(),
    }.items():
        (tmp_path / name).write_bytes(data)
    for call in (registry.validate, registry.identity, registry.make):
        with pytest.raises(InputError) as refused:
            call(spec, tmp_path)
        assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("bsdf", "message"),
    [
        ({"type": "conductor"}, "delta"),
        ({"type": "roughdielectric"}, "transmits"),
        ({"type": "no-such-plugin"}, "cannot load"),
        ({"type": "diffuse", "reflectance": {"type": "sphere"}}, "cannot load"),
    ],
)
def test_refused_by_mitsuba(bsdf, message):
    with pytest.raises(InputError, match=message):
        registry.make({"name": "x", "type": "mitsuba", "bsdf": bsdf})
