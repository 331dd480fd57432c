"""``harness validate`` builds what a suite describes, and lists all mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.cli.main import main

ROOM = """<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
  <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
  </sensor><emitter type="constant"/><bsdf type="diffuse" id="metal"/>
  <shape type="{shape}"><ref id="metal"/></shape></scene>"""
SUITE = """
name: mine
materials:
  - {{name: chalk, type: mitsuba, bsdf: {chalk}}}
scenes: [{{file: room.xml, replace_bsdf: metal}}]
methods: {methods}
measures: [pdf, equal-spp]
"""
GOOD = {"chalk": "{type: diffuse, reflectance: {type: checkerboard, to_uv: {scale: 8}}}",
        "methods": "[cosine]"}  # fmt: skip


@pytest.fixture
def written(tmp_path):
    """Writes the suite and its scene; gives the suite's file."""

    def write(shape="sphere", **changed):
        (tmp_path / "room.xml").write_text(ROOM.format(shape=shape))
        (tmp_path / "suite.yaml").write_text(SUITE.format(**GOOD | changed))
        return str(tmp_path / "suite.yaml")

    return write


def test_a_good_suite(written, capsys):
    """With a scene that has no name, and a transform in a dictionary."""
    assert main(["validate", written()]) == 0
    assert "3 trials" in capsys.readouterr().out


def test_all_mistakes_are_listed(written, capsys, tmp_path):
    """In one go, a line each, of every kind."""
    file = written(
        shape="icosahedron",
        chalk="{type: difuse}}\n  - {name: black, type: mitsuba, bsdf: {type: diffuse, "
        "reflectance: [0.0, 0.0, 0.0]}}\n  - {name: tilted, type: mitsuba, bsdf: {type: diffuse, "
        "reflectance: {type: checkerboard, to_uv: {scle: 8}}}",
        methods="[cosine, {name: improved-baseline, params: {wdth: 3}}]",
    )
    assert main(["validate", file]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    for said in ("difuse", "reflects nothing", "did you mean 'scale'", "'wdth'", "icosahedron"):
        assert sum(said in line for line in lines) == 1, (said, lines)
    assert len(lines) == 5 and all(line.startswith(f"error: {file}: ") for line in lines)


def test_a_mistake_of_a_scene_is_said_once(written, capsys):
    """Not once more with every material; and what one material lacks, once for each."""
    more = "{type: diffuse}}\n  - {name: slate, type: mitsuba, bsdf: {type: diffuse}"
    file = written(shape="icosahedron", chalk=more)
    assert main(["validate", file]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "'room' with 'chalk'" in line and "icosahedron" in line
    text = Path(written(chalk=more)).read_text()
    Path(file).write_text(text.replace("metal}", "metal, effects: [environment, parallax]}"))
    assert main(["validate", file]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert [sum(name in line for line in lines) for name in ("'chalk'", "'slate'")] == [1, 1], lines


def test_a_material_that_cannot_be_seen(written, capsys, tmp_path):
    """A sphere that shows its back, which is black: one line instead of an empty picture."""
    file = written()
    room = tmp_path / "room.xml"
    flipped = '<shape type="sphere"><boolean name="flip_normals" value="true"/>'
    room.write_text(room.read_text().replace('<shape type="sphere">', flipped))
    assert main(["validate", file]) == 2
    assert "no camera ray meets the material" in capsys.readouterr().err


def test_a_run_names_the_first(written, capsys, tmp_path):
    """And says how to see the others."""
    text = (tmp_path / written().rpartition("/")[2]).read_text()
    (tmp_path / "suite.yaml").write_text(text + "unknown: 1\nresolution: many\n")
    out = str(tmp_path / "out")
    assert main(["run", str(tmp_path / "suite.yaml"), "--out", out]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "and 1 more, which 'harness validate' lists" in line


def test_a_plugin_that_is_not_there(written, capsys):
    """Says how one's own is named."""
    assert main(["validate", written(chalk="{type: my_python_bsdf}")]) == 2
    assert "file.py:Class" in capsys.readouterr().err


def test_a_material_that_reads_the_scene(written, capsys, tmp_path):
    """Is found before anything runs."""
    (tmp_path / "own.py").write_text(
        "import drjit as dr, mitsuba as mi\n"
        "class Own(mi.BSDF):\n"
        "    def __init__(self, props):\n"
        "        super().__init__(props)\n"
        "        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide\n"
        "        self.m_components = [self.m_flags]\n"
        "    def sample(self, ctx, si, a, b, active=True):\n"
        "        bs = dr.zeros(mi.BSDFSample3f, dr.width(si.wi))\n"
        "        bs.wo, bs.eta = mi.warp.square_to_cosine_hemisphere(b), 1.0\n"
        "        bs.pdf = bs.wo.z * dr.inv_pi\n"
        "        return bs, mi.Color3f(0.5)\n"
        "    def eval(self, ctx, si, wo, active=True):\n"
        "        there = dr.reinterpret_array(mi.UInt32, si.shape) != 0\n"
        "        f = dr.select(there, 0.9, 0.1) * wo.z * dr.inv_pi\n"
        "        return mi.Color3f(dr.select((si.wi.z > 0) & (wo.z > 0), f, 0))\n"
        "    def pdf(self, ctx, si, wo, active=True):\n"
        "        return dr.select(wo.z > 0, wo.z * dr.inv_pi, 0)\n"
        "    def traverse(self, callback):\n"
        "        pass\n"
    )
    assert main(["validate", written(chalk="{type: 'own.py:Own'}")]) == 2
    said = capsys.readouterr().err
    assert "points of this scene" in said and "'room' with 'chalk'" in said
