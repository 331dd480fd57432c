"""What effects cost and change: the estimator, the verdicts, ``auto``, the verb and its table."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.analysis.records.effects import VERDICTS
from harness.analysis.results import Results
from harness.cli.main import main
from harness.core import registry
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.effects.base import Offer
from harness.effects.offer import offer
from harness.effects.registry import checked, is_auto, recipe
from harness.effects.variants import explicit, full, with_one_more, without
from harness.measures import registry as measures
from harness.measures.base import Job
from harness.measures.flip import exposures, flip
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.scenes.base import Scene
from harness.stats.difference import difference
from harness.store.folder import ResultsFolder
from tests.effect_fakes import OWN, Offset, hall
from tests.measuring import run

variant.use("cpu")

from harness.materials.mitsuba_bsdf import MitsubaMaterial  # noqa: E402
from harness.measures.auto import resolve  # noqa: E402
from harness.measures.effects import FULL, variants_of  # noqa: E402

OFFER = Offer("hall", frozenset({"environment", "area-lights", "point-lights"}), material=OWN)


def grey() -> Material:
    return MitsubaMaterial(
        "grey", {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}, {"type": "test"}
    )


# --- the estimator ---------------------------------------------------------------------


@given(st.floats(-0.5, 0.5), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_difference_has_no_noise_in_it(shift, seed):
    """Its interval holds the squared shift, be the noise ten times as large."""
    rng = np.random.default_rng(seed)
    a, b = 1 + rng.normal(0, 1, (2, 8, 24, 24, 3))
    found = difference(a + shift, b)
    power = float(np.square(b.mean(0)).mean())
    wanted = shift**2 / power
    half = (found.value.high - found.value.low) / 2
    assert abs(found.value.value - wanted) < 4 * half + 1e-9
    assert found.noise == pytest.approx(2 / 8 / power, rel=0.15)


def test_difference_is_unbiased_and_its_interval_covers():
    rng = np.random.default_rng(1)
    values, hits = [], 0
    for _ in range(400):
        a, b = 1 + rng.normal(0, 0.5, (2, 8, 6, 6, 1))
        found = difference(a + 0.1, b).value
        # Over the true mean square; that of a finite image has its noise in it.
        scale = np.square(b.mean(0)).mean()
        values.append(found.value * scale)
        hits += found.low * scale <= 0.01 <= found.high * scale
    assert np.mean(values) == pytest.approx(0.01, abs=4 * np.std(values) / 20)
    assert 0.90 < hits / 400 < 0.99


def test_noise_in_common_does_not_count():
    rng = np.random.default_rng(2)
    a = 1 + rng.normal(0, 1, (6, 8, 8, 3))
    same = difference(a, a)
    assert same.value == (0, 0, 0) and same.noise == 0
    assert difference(a + 0.2, a).value.low > 0
    with pytest.raises(ValueError, match="three renders"):
        difference(a[:2], a[:2])
    with pytest.raises(ValueError, match="not black"):
        difference(a, 0 * a)


def test_flip_keeps_its_exposure():
    rng = np.random.default_rng(3)
    image = rng.random((24, 32, 3))
    pinned = exposures(image)
    assert flip(image, image, pinned)[0] == 0
    small, large = (flip(image * factor, image, pinned)[0] for factor in (1.05, 2.0))
    assert 0 < small < large < 1
    assert exposures(2 * image)["startExposure"] == pytest.approx(pinned["startExposure"] - 1)
    mean, shown = flip(0 * image, image, pinned)
    assert shown.shape == (24, 32) and mean == pytest.approx(shown.mean(), rel=1e-3)
    assert mean > 0.3


# --- lists with one more or less -------------------------------------------------------


def test_explicit_names_what_runs_by_default():
    assert set(explicit(["environment"], OFFER)) == {"environment", "colour: rgb", *OWN}
    assert explicit(["environment", "texture"], OFFER) == ("environment", "colour: rgb", "texture")
    plain = ["environment", "material: plain", "colour: luminance"]
    assert set(explicit(plain, OFFER)) == set(plain)
    bare = replace(OFFER, material=frozenset())
    assert explicit(["environment"], bare) == ("environment", "colour: rgb")


@pytest.mark.parametrize("text", full(OFFER))
def test_one_less_takes_one_thing_away(text):
    everything = full(OFFER)
    name = text.partition(":")[0]
    before, after = recipe(everything), recipe(without(everything, name, OFFER))
    changed = [k for k, v in vars(before).items() if vars(after)[k] != v]
    expected = {"media": ["media", "material"]}.get(name)
    assert changed == expected if expected else len(changed) == 1
    again = with_one_more(without(everything, name, OFFER), OFFER)
    if name != "colour":  # One channel is something said of colour.
        assert recipe(again[name]) == before


def test_the_last_of_a_material_leaves_it_plain():
    one = replace(OFFER, material=frozenset({"texture"}))
    assert recipe(without(["environment", "texture"], "texture", one)).material == frozenset()


def test_a_light_brings_what_it_needs():
    assert recipe(with_one_more(("environment",), OFFER)["point-lights"]).emitter_sampling


# --- the measure -----------------------------------------------------------------------


def job(scene: Scene, material: Material, method: str = "cosine", **changed: object) -> Job:
    made = registry.make(method)
    made.bind(material)
    given_ = {
        "rounds": 6, "spp": 32, "slice_seconds": 0.01, "resolution": 12, "warm_up": 0.0
    } | changed  # fmt: skip
    return Job(
        SimpleNamespace(), material, made, scene, 0, torch.Generator().manual_seed(0),
        measures.settings("effects", given_),
        Budget(), lambda: made,
    )  # fmt: skip


def measured(scene: Scene, material: Material, **changed: object) -> tuple[dict, dict, dict]:
    """Verdicts by effect, values by metric, images."""
    outcome = run("effects", [job(scene, material, **changed)])[0]
    assert outcome.status == "ok"
    values = {r.metric: r.value for r in outcome.records}
    verdicts = {
        k.removesuffix(".verdict"): VERDICTS[int(v)]
        for k, v in values.items()
        if k.endswith(".verdict")
    }
    return verdicts, values, outcome.images


@pytest.mark.slow
def test_verdicts_of_a_scene_with_a_dark_lamp():
    """Of the effects that it calls for and of those it does not; and what runs for each."""
    scene = hall("environment", "area-lights", dark="area-lights", grey=True)
    verdicts, values, images = measured(scene, grey())
    assert verdicts["environment"] == "needed" and verdicts["area-lights"] == "negligible"
    assert verdicts["point-lights"] == "missing" and verdicts["indirect"] == "missing"
    assert verdicts["colour"] == "negligible"
    assert set(verdicts) == {
        "environment", "area-lights", "point-lights", "indirect", "colour", "emitter-sampling",
        "depth-of-field",
    }  # fmt: skip
    assert values["emitter-sampling.shadow-rays"] > 0.5
    assert 0.2 < values["emitter-sampling.pdf-queries"] < values["emitter-sampling.shadow-rays"]
    assert values["indirect.bounces"] > 0 == values["indirect.shadow-rays"]
    assert values["colour.values"] == pytest.approx(
        2 * values["emitter-sampling.samples"] + 1, abs=2
    )
    assert images["full"].shape == images["indirect"].shape == images["indirect.flip"].shape
    assert values["environment.relmse"] > 0.1 > values["area-lights.relmse"]


@pytest.mark.slow
def test_bounces_that_never_happen_cost_and_change_nothing():
    """A ball alone: the image is the same to the last bit, from the same random numbers."""
    for effects in (("environment", "indirect: 4"), ("environment",)):
        verdicts, values, _ = measured(hall(*effects, apart=True), grey())
        assert verdicts["indirect"] in ("negligible", "not needed")
        assert values["indirect.relmse"] == 0 == values["indirect.flip"]
        assert values["indirect.unclear"] == 0
        assert values["indirect.rays"] == pytest.approx(0, abs=0.1)


@pytest.mark.slow
def test_effects_of_a_material_are_told_apart():
    verdicts, values, _ = measured(hall("environment", grey=True), Offset())
    # Averaged stripes do not move.
    assert verdicts.pop("parallax") == "negligible"
    assert {verdicts[name] for name in OWN - {"parallax"}} == {"needed"}
    for name in OWN:
        assert values[f"{name}.{name}"] > 0
    moving, _, _ = measured(hall("environment", "parallax", grey=True), Offset())
    assert moving["parallax"] == "needed" and moving["media"] == "missing"
    idle, _, _ = measured(hall("environment", "parallax", grey=True), Offset(strength=0.0))
    assert idle["parallax"] == "negligible" and idle["prefiltering"] == "not needed"


def test_the_only_light_is_needed_and_not_rendered_without():
    scene = replace(hall("environment"), lamps=())
    assert "environment" not in variants_of(job(scene, grey()))
    assert variants_of(job(scene, grey()))[FULL] == ("environment", "colour: rgb")
    verdicts, values, _ = measured(scene, grey())
    assert verdicts["environment"] == "needed" and values["environment.relmse"] == 1
    assert "environment.seconds" not in values


# --- auto ------------------------------------------------------------------------------


def test_auto_leaves_out_what_does_nothing():
    """A ball alone under a lamp that is dark: one light, one bounce; and the reasons."""
    scene = replace(hall(apart=True, dark="area-lights"), effects=("auto: 0.02",))
    scene = replace(scene, lamps=scene.lamps[:1], camera=replace(scene.camera, aperture=0.0))
    found, choice = resolve(scene, grey())
    assert "environment" in found.effects and found.effects == choice.effects
    assert not {"area-lights", "indirect: 12", "point-lights"} & set(found.effects)
    assert recipe(found.effects).bounces == 1 and recipe(found.effects).channels == 1
    assert set(choice.why) == {t.partition(":")[0] for t in choice.everything}
    assert choice.why["environment"] == "kept: the only light"
    assert all(("left out" in w) or ("kept" in w) for w in choice.why.values())
    assert resolve(scene, grey())[1].as_json() == choice.as_json()
    json.dumps(choice.as_json())


def test_auto_keeps_what_matters():
    """A lamp, light between two balls, stripes that move with the view."""
    scene = replace(hall("environment"), effects=checked({"auto": 0.01}, "x"))
    scene = replace(scene, environment=0.2, camera=replace(scene.camera, aperture=0.0))
    assert is_auto(scene.effects)
    found, choice = resolve(scene, Offset())
    made = recipe(found.effects)
    assert made.lights == {"environment", "area-lights", "point-lights"} and made.bounces > 1
    assert made.emitter_sampling and made.channels == 3
    # Stripes that are averaged away do not move.
    assert "prefiltering" in found.effects and "parallax" not in found.effects
    assert "lights without extent" in choice.why["emitter-sampling"]
    assert set(choice.everything) >= OWN


# --- a suite ---------------------------------------------------------------------------


PLAIN = {"name": "plain", "type": "mitsuba", "bsdf": {"type": "diffuse"}}
"""Quickly compiled in all variants."""


def suite(folder: Path, scene: object, material: object = "brushed-metal") -> Path:
    content = {
        "name": "tiny",
        "materials": [material],
        "methods": ["native", "cosine"],
        "scenes": [scene],
        "measures": [{"name": "pdf", "conditions": 4}, {
            "name": "effects", "rounds": 6, "spp": 2,
            "slice_seconds": 0.01, "resolution": 12, "warm_up": 0.0,
        }],
    }  # fmt: skip
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_the_verb_measures_effects_alone_and_reports_them(tmp_path, capsys, monkeypatch):
    # Not to wait for whatever else is timed on this machine.
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = suite(tmp_path, {"name": "ball", "scene": "uniform-sphere", "size": "small",
                            "effects": {"auto": 0.2}}, PLAIN)  # fmt: skip
    assert main(["effects", str(path), "--out", str(tmp_path / "out"), "--method", "cosine"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "environment" in said and "needed" in said
    results = Results.load(tmp_path / "out")
    assert set(results.frame["measure"]) == {"fit", "effects"}
    assert set(results.frame["method"]) == {"cosine"}
    stored = results.stored(results.trials("effects")[0]).effects
    assert stored["tolerance"] == 0.2 and "indirect" in stored["why"]
    written = (tmp_path / "out" / "report" / "effects.md").read_text()
    assert "| environment |" in written and "relMSE" in written
    assert "ball, plain: auto chose environment" in written
    assert list((tmp_path / "out" / "report" / "figures").glob("effects-ball-*.png"))


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"name": "studio-sphere", "effects": ["environment", "parallax"]}, "cannot give it"),
        ({"name": "studio-sphere", "effects": ["environment", "media"]}, "neither the scene"),
        ({"name": "studio-sphere", "effects": ["environment", "paralax"]}, "did you mean 'paral"),
        ({"name": "studio-sphere", "effects": ["area-lights"]}, "has no such light"),
    ],
)
@pytest.mark.parametrize("verb", ["run", "validate", "effects"])
def test_what_cannot_be_had_is_refused_before_anything_runs(tmp_path, capsys, verb, scene, message):
    path = suite(tmp_path, scene)
    out = ["--out", str(tmp_path / "out")] if verb != "validate" else []
    assert main([verb, str(path), *out]) == 2
    error = capsys.readouterr().err
    lines = error.splitlines()
    assert message in error and all(str(path) in line for line in lines)
    # validate lists all that is wrong, the scene by itself and with each material.
    assert len(lines) == 1 or verb == "validate"
    if (tmp_path / "out").exists():
        with ResultsFolder(tmp_path / "out") as store:
            assert not store.trials()


def test_the_verb_refuses_a_method_that_is_not_there(tmp_path, capsys):
    path = suite(tmp_path, "uniform-sphere")
    assert main(["effects", str(path), "--method", "nativ"]) == 2
    assert "did you mean 'native'" in capsys.readouterr().err


def test_auto_is_part_of_what_determines_a_trial():
    plain = scenes.identity("studio-sphere")
    auto = scenes.identity({"name": "studio-sphere", "effects": "auto"})
    other = scenes.identity({"name": "studio-sphere", "effects": {"auto": 0.5}})
    assert plain != auto != other
    assert "auto" in str(auto["effects"]) and "auto" not in str(plain["effects"])
    assert offer(scenes.make("studio-sphere")).lights == {"environment"}


@pytest.mark.slow
def test_point_lights_alone():
    """Without light sampling the image is black: needed, and no noise to be lowered."""
    verdicts, values, _ = measured(hall("point-lights", "emitter-sampling", grey=True), grey())
    assert verdicts["emitter-sampling"] == "needed" == verdicts["point-lights"]
    assert values["emitter-sampling.relmse"] == pytest.approx(1, abs=0.1)
    assert "emitter-sampling.gain" not in values
