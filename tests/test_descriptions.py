"""Descriptions of microgeometry: the twelve, the language, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from harness.core.protocol.errors import InputError
from harness.materials import registry
from harness.microgeometry import descriptions
from harness.microgeometry.description import parse
from harness.microgeometry.expressions import Expression
from harness.microgeometry.functions import FUNCTIONS
from harness.microgeometry.walks import surfaces

PLAIN = {"name": "x", "about": "a test", "colour": [{"colour": "#808080"}]}


def textures(surface) -> dict[str, np.ndarray]:
    """All fields of a surface, [R, R] or [R, R, C]."""
    found = {k: v["array"] for k, v in surface.bsdf.items() if isinstance(v, dict)}
    found["height"] = surface.height
    if surface.angle is not None:
        found["angle"] = np.cos(2 * surface.angle)
    return found


# --- the twelve ------------------------------------------------------------------------


def test_there_are_twelve_under_names_of_their_own():
    names = surfaces.reliefs()
    assert len(names) == 12 and "leather" in names
    assert not set(names) & {*registry.names(), *registry.hard_names()}


@pytest.mark.parametrize("name", surfaces.reliefs())
def test_each_is_a_learnable_tile_without_a_seam(name):
    """The jump over the tile's edge is no greater than the jumps inside it."""
    surface = descriptions.load(name, resolution=128)
    assert surface.name == name
    assert surface.slope < 0.4
    for field in textures(surface).values():
        for axis in (0, 1):
            jump = np.abs(np.diff(field, axis=axis, append=np.take(field, [0], axis)))
            jump = jump.reshape(*jump.shape[:2], -1).max(2).mean(1 - axis)
            inside, seam = jump[:-1], jump[-1]
            assert seam <= inside.max() * 1.25 + 1e-9


@pytest.mark.parametrize("name", ["leather", "bulkhead"])
def test_a_description_means_the_same_at_any_resolution(name):
    """The mean over blocks of a fine tile is about the coarse tile; seeds decide the rest."""
    coarse, again, fine = (descriptions.load(name, resolution=r) for r in (64, 64, 256))
    for a, b, c in zip(*(textures(s).values() for s in (coarse, again, fine)), strict=True):
        assert np.array_equal(a, b)
        block = c.reshape(64, 4, 64, 4, -1).mean((1, 3))
        a = a.reshape(64, 64, -1)
        assert np.corrcoef(a.ravel(), block.ravel())[0, 1] > 0.85
    assert coarse.identity() == again.identity() != fine.identity()


# --- the language ----------------------------------------------------------------------


def test_arithmetic_is_python_s():
    fields = {"a": np.full((4, 4), 3.0)}
    value = Expression("-(a - 1) ** 2 / 4 + 2 * a % 4", fields)(4, fields)
    assert np.array_equal(value, np.full((4, 4), -1 + 2.0))
    assert Expression(0.25, {})(4, {}) == 0.25


def test_coordinates_are_texel_centres():
    u = Expression("u()", {})(4, {})
    assert np.allclose(u[0], [0.125, 0.375, 0.625, 0.875]) and (u == u[0]).all()
    assert np.array_equal(Expression("v()", {})(4, {}), u.T)


def test_lengths_are_widths_of_the_tile():
    """A blur of a step has the same profile at two resolutions."""
    profile = {}
    for size in (32, 128):
        step = np.tile((np.arange(size) < size // 2).astype(float), (size, 1))
        blurred = Expression("blur(x, 0.05, 0.0)", {"x"})(size, {"x": step})
        profile[size] = np.interp(
            np.linspace(0.3, 0.7, 9), (np.arange(size) + 0.5) / size, blurred[0]
        )
    assert np.allclose(profile[32], profile[128], atol=0.02)


def test_lines_of_a_ramp_run_across_its_slope():
    """sin(2 pi u) is constant along v, a quarter turn from u (modulo half a turn)."""
    angle = Expression("slope_angle(sin(6.2831853 * u()))", {})(32, {})
    assert np.allclose(np.abs(angle), np.pi / 2, atol=1e-6)


def test_every_function_says_what_it_gives():
    for name, function in FUNCTIONS.items():
        assert function.__doc__ and len(function.__doc__.splitlines()) == 1, name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gain * 2", "unknown field 'gain'; did you mean 'grain'?"),
        ("nois(3, seed=1)", "unknown function 'nois'; did you mean 'noise'?"),
        ("noise(3, sed=1)", "noise(): unknown argument 'sed'; did you mean 'seed'?"),
        ("noise(3)", "noise(): missing a required argument: 'seed'"),
        ("cells(3, seed=1).boarder", "cells() has no '.boarder'; did you mean 'border'?"),
        ("u().real", "u() has no '.real'"),
        ("grain +", "not an expression"),
        ("__import__('os')", "unknown function '__import__'"),
        ("grain.__class__", "expected numbers, fields, + - * / % ** and functions"),
        ("[1, 2]", "expected numbers, fields"),
        ("True", "expected numbers, fields"),
    ],
)
def test_what_means_nothing_is_refused_before_computing(text, message):
    with pytest.raises(InputError, match=re.escape(message)):
        Expression(text, ["grain"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cells(3, seed=1)", "expected one field, so one of .nearest, .border, .value"),
        ("noise(0, seed=1)", "cells: expected a whole number of at least 1, got 0"),
        ("noise(1.5, seed=1)", "cells: expected a whole number of at least 1, got 1.5"),
        ('weave(8, "twil", seed=1).height', "did you mean 'twill'?"),
        ('weave(6, "satin", seed=1).height', "expected a multiple of 8 threads"),
        ('motif("clovr", 2)', "did you mean 'clover'?"),
        ("scales(4, 3, seed=1).rim", "expected an even number"),
        ("step(u(), 1, 1)", "expected two different ends"),
        ("unit(3)", "expected a field that varies"),
        ("sqrt(u() - 2)", "invalid value"),
        ("1 / (u() - u())", "divide by zero"),
    ],
)
def test_what_cannot_be_computed_is_refused(text, message):
    with pytest.raises(InputError, match=re.escape(message)):
        Expression(text, [])(16, {})


# --- descriptions ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rougness": 0.3}, "unknown key 'rougness'; did you mean 'roughness'?"),
        ({"colour": []}, "colour: "),
        ({"colour": [{"colour": "red"}]}, "colour"),
        ({"colour": [{"by": "u()"}]}, "expected 'by' and 'ramp', or 'colour', or 'shade'"),
        ({"colour": [{"by": "u()", "ramp": [["a", "#000000"], [1, "#ffffff"]]}]}, "stops such as"),
        ({"relief": {"field": "hight", "depth": 0.1}, "fields": {"height": 1}}, "mean 'height'?"),
        ({"relief": {"field": 1, "depth": -1}}, "relief.depth"),
        ({"fields": {"a": "b", "b": 1}}, "fields.a: unknown field 'b'"),
        ({"fields": {"a b": 1}}, "fields: 'a b'"),
        ({"resolution": 30}, "resolution"),
    ],
)
def test_descriptions_are_refused_in_one_line(change, message):
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        parse({**PLAIN, **change})
    assert "\n" not in str(caught.value)


def test_values_that_are_no_reflectance_are_refused():
    with pytest.raises(
        InputError, match=r"roughness: expected values from 0 to 1, got 0.0156 to 1.98"
    ):
        parse({**PLAIN, "roughness": "2 * u()"}).surface(64)


def test_files_are_named_in_the_refusal(tmp_path: Path):
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: bad\nabout: x\ncolour: [{shade: 1}\n")
    with pytest.raises(InputError, match=r"bad.yaml, line 4: not valid YAML"):
        descriptions.load(bad)
    bad.write_text("name: bad\ncolour:\n  - {shade: mix(0, 1, u())}\n")
    with pytest.raises(InputError, match=r"bad.yaml: colour\[0\]: expected a text as key, got 1"):
        descriptions.load(bad)
    bad.write_text("name: bad\nname: worse\n")
    with pytest.raises(InputError, match="the key 'name' is given twice"):
        descriptions.load(bad)
    bad.write_text("name: bad\nabout: x\ncolour: [{shade: 3 * u()}]\n")
    with pytest.raises(InputError, match=r"bad.yaml: colour\[0\].shade: expected values from 0"):
        descriptions.load(bad)
    with pytest.raises(InputError, match="no such description: lether; did you mean 'leather'"):
        descriptions.load("lether")
    with pytest.raises(InputError, match="multiple of 4"):
        descriptions.load("leather", resolution=33)


def test_identity_covers_what_changes_the_surface():
    plain = parse(PLAIN).surface(16)
    assert plain.identity() == parse({**PLAIN, "about": "other words"}).surface(16).identity()
    assert plain.identity() != parse({**PLAIN, "roughness": 0.4}).surface(16).identity()


def test_the_manual_names_every_function_and_key():
    from harness.core.paths import ROOT
    from harness.microgeometry.description import Description

    manual = (ROOT / "docs" / "microgeometry.md").read_text(encoding="utf-8")
    tables = "".join(line for line in manual.splitlines() if line.startswith("|"))
    words = set(re.findall(r"[a-z_]+", tables))
    assert {*FUNCTIONS, *Description.model_fields} - {"fields"} <= words
