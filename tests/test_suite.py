"""Suites: what they mean, what they refuse, and the hashes of their trials."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml

from harness import Budget
from harness.core import machine
from harness.core.protocol.errors import InputError
from harness.measures import registry as measures
from harness.runner.validity import Validity
from harness.suite import load as loading
from harness.suite import plan as planning
from harness.suite.load import load
from harness.suite.plan import Plan, make_plan
from harness.suite.schema import BudgetSpec
from harness.suite.trials import canonical, stream_seed
from tests import fakes


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


def plan_of(folder: Path, profile: str | None = None, **changes: Any) -> Plan:
    return make_plan(load(fakes.suite(folder, **changes)), profile)


def hashes(plan: Plan) -> set[str]:
    return {trial.hash for trial in plan.trials}


def refused(folder: Path, **changes: Any) -> str:
    with pytest.raises(InputError) as error:
        make_plan(load(fakes.suite(folder, **changes)))
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(str(folder / "suite.yaml"))
    return text.removeprefix(str(folder / "suite.yaml"))


# --- expansion ---------------------------------------------------------------------------------


def test_product(tmp_path: Path):
    plan = plan_of(tmp_path, seeds=[0, 1])
    assert len(plan.trials) == 2 * 2 * 2 * 3
    assert plan.labels("measure") == ["fit", "probe", "clock"]
    by_hash = {trial.hash: trial for trial in plan.trials}
    for trial in plan.trials:
        assert (trial.scene != "") == (trial.measure == "clock")
        if trial.measure != "fit":
            fit = by_hash[trial.fit]
            for key in ("material", "method", "seed"):
                assert getattr(fit, key) == getattr(trial, key)


def test_profile_takes_a_part_and_overrides(tmp_path: Path):
    quick = {
        "materials": ["fake-b"],
        "methods": ["with-state"],
        "resolution": 99,
        "budget": {"steps": 7, "pool": 5},
        "measures": {"probe": {"rows": 3}},
        "override": {"with-state": {"params": {"scale": 3.0}, "budget": {"steps": 9}}},
    }
    plan = plan_of(
        tmp_path,
        budget={"steps": 1, "directions": 2},
        profiles={"quick": quick},
        baseline="with-state",
        resolution=50,
    )
    assert plan.profile == "quick"
    assert {t.material for t in plan.trials} == {"fake-b"}
    fit, probe, clock = plan.trials
    assert fit.params == {"scale": 3.0}
    assert (fit.budget.steps, fit.budget.pool, fit.budget.directions) == (9, 5, 2)
    assert probe.settings == {"rows": 3, "poison": False}
    assert clock.settings == {"resolution": 99}


def test_a_measure_is_planned_where_it_says_something(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def why_not(cls: type, scene: Any) -> str:
        return "" if scene.name == "fake-room" else f"{scene.name} is dark"

    monkeypatch.setattr(measures.load("clock"), "why_not", classmethod(why_not))
    both = plan_of(tmp_path, scenes=["fake-room", "fake-cave"], measures=["clock"])
    assert both.labels("scene") == ["fake-room"]
    with pytest.raises(InputError, match="measures: 'clock': fake-cave is dark"):
        plan_of(tmp_path, scenes=["fake-cave"], measures=["clock"])


def test_labels_show_parameters(tmp_path: Path):
    both = [{"name": "adapters.py:Named", "params": {"scale": 2.0}}, "adapters.py:Named"]
    plan = plan_of(tmp_path, methods=both, baseline=None)
    assert plan.labels("method") == ["with-state (scale=2.0)", "with-state"]
    assert plan.baseline == "with-state (scale=2.0)"


def test_budget_of_a_suite_is_that_of_the_protocol():
    assert set(BudgetSpec.model_fields) == {f.name for f in fields(Budget)} - {"device"}


@pytest.mark.parametrize("name", loading.names())
def test_shipped_suites_are_valid(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # One takes a folder of the user's own.
    (tmp_path / "rgl").mkdir()
    (tmp_path / "rgl" / "paint_rgb.bsdf").touch()
    monkeypatch.chdir(tmp_path)
    suite = load(name).suite
    assert suite.name == name
    assert suite.title


def test_a_folder_is_a_material_a_file(tmp_path: Path):
    entry = {"type": "measured", "folder": "mine"}
    path = fakes.suite(tmp_path, materials=["fake-a", entry])
    with pytest.raises(InputError, match=r"materials\[1\]: no such folder: mine"):
        load(path)
    folder = path.parent / "mine"
    folder.mkdir()
    with pytest.raises(InputError, match=r"no file \*\.bsdf in the folder mine"):
        load(path)
    for name in ("silk_rgb.bsdf", "paint.bsdf", "readme.txt"):
        (folder / name).touch()
    materials = load(path).suite.materials
    assert [m.name for m in materials] == ["fake-a", "paint", "silk"]
    assert [Path(m.rest()["file"]).name for m in materials[1:]] == ["paint.bsdf", "silk_rgb.bsdf"]
    for wrong, said in (
        ({**entry, "file": "x.bsdf"}, "unknown key 'file' beside 'folder'"),
        ({"folder": "mine"}, "'folder' goes with 'type: measured'"),
        ({**entry, "folder": 3}, "expected the name of a folder, not 3"),
    ):
        with pytest.raises(InputError, match=said):
            load(fakes.suite(tmp_path, materials=[wrong]))


# --- hashes ------------------------------------------------------------------------------------


def test_hashes_hold_no_path(tmp_path: Path):
    here, there = plan_of(tmp_path / "a"), plan_of(tmp_path / "deep" / "b")
    assert hashes(here) == hashes(there)
    assert str(tmp_path) not in canonical([t.identity for t in here.trials])


def test_hashes_hold_no_ordering(tmp_path: Path):
    plain = plan_of(tmp_path / "a")
    turned = plan_of(
        tmp_path / "b",
        materials=["fake-b", "fake-a"],
        methods=["adapters.py:Named", "adapters.py:Good"],
        measures=["clock", "probe"],
    )
    assert hashes(plain) == hashes(turned)
    path = fakes.suite(tmp_path / "c")
    data = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(dict(reversed(data.items())), sort_keys=False))
    assert hashes(make_plan(load(path))) == hashes(plain)


def test_hashes_hold_no_label_and_no_suite(tmp_path: Path):
    label = [{"name": "adapters.py:Good", "label": "plain"}, "adapters.py:Named"]
    renamed = plan_of(tmp_path / "b", name="other", methods=label, baseline="plain")
    assert hashes(renamed) == hashes(plan_of(tmp_path / "a"))


def test_defaults_written_out_change_nothing(tmp_path: Path):
    plain = plan_of(tmp_path / "a")
    explicit = plan_of(
        tmp_path / "b",
        measures=[{"name": "probe", "rows": 8}, "clock"],
        budget={"steps": Budget().steps, "max_seconds": 100.0},
    )
    assert hashes(explicit) == hashes(plain)


@pytest.mark.parametrize(
    "changes",
    [
        {"methods": ["adapters.py:Good", {"name": "adapters.py:Named", "params": {"scale": 2}}]},
        {"methods": ["adapters.py:Good", {"name": "adapters.py:Named", "budget": {"steps": 2}}]},
        {"budget": {"pool": 17}},
        {"seeds": [1]},
        {"measures": [{"name": "probe", "rows": 9}, "clock"]},
        {"materials": ["fake-a", {"name": "fake-b", "type": "x"}]},
        {"scenes": [{"name": "fake-room", "light": 2}]},
    ],
)
def test_what_changes_numbers_changes_hashes(tmp_path: Path, changes: dict[str, Any]):
    plain, other = plan_of(tmp_path / "a"), plan_of(tmp_path / "b", **changes)
    assert len(plain.trials) == len(other.trials)
    assert hashes(plain) != hashes(other)


def test_code_is_no_part_of_a_key_and_is_a_part_of_what_it_stands_on(tmp_path: Path):
    before = plan_of(tmp_path)
    parts = [Validity(before, {}).parts(trial) for trial in before.trials]
    file = tmp_path / "adapters.py"
    file.write_text("# a remark\n" + fakes.ADAPTERS)
    after = make_plan(load(tmp_path / "suite.yaml"))
    assert hashes(after) == hashes(before)
    assert [Validity(after, {}).parts(trial) for trial in after.trials] == parts
    file.write_text(fakes.ADAPTERS.replace("1 / math.pi", "2 / math.pi"))
    after = make_plan(load(tmp_path / "suite.yaml"))
    assert hashes(after) == hashes(before)
    for trial, old in zip(after.trials, parts, strict=True):
        now = Validity(after, {}).parts(trial)
        changed = {part for part in now if now[part] != old[part]}
        # The fake timing never asks for a density.
        assert changed == ({"adapter"} if trial.measure != "clock" else set())


def test_only_times_belong_to_a_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    here = plan_of(tmp_path)
    monkeypatch.setattr(machine, "identity", lambda device="cpu": {"cpu": "another", "cores": 1})
    there = make_plan(load(tmp_path / "suite.yaml"))
    for one, two in zip(here.trials, there.trials, strict=True):
        assert (one.hash == two.hash) == (one.measure == "probe")


def test_times_count_the_baseline_too(tmp_path: Path):
    methods = [{"name": "adapters.py:Good", "budget": {"steps": 5}}, "adapters.py:Named"]
    plain, other = plan_of(tmp_path / "a"), plan_of(tmp_path / "b", methods=methods)
    for one, two in zip(plain.trials, other.trials, strict=True):
        if one.method == "with-state":
            assert (one.hash == two.hash) == (one.measure != "clock")


def test_versions_count_without_their_build_tag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    here = plan_of(tmp_path)
    before = Validity(here, {}).parts(here.trials[0])
    assert "torch" in before["versions"] and "+" not in before["versions"]
    monkeypatch.setattr(machine, "versions", lambda: {"torch": "9"})
    there = make_plan(load(tmp_path / "suite.yaml"))
    assert hashes(here) == hashes(there)
    assert Validity(there, {}).parts(there.trials[0]) == before | {"versions": "torch 9"}


def test_streams_differ_by_measure_and_seed_alone():
    assert len({stream_seed(m, s) for m in ("fit", "pdf") for s in (0, 1)}) == 4


# --- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metods": []}, ": unknown key 'metods'; did you mean 'methods'?"),
        ({"name": None}, ": missing key 'name'"),
        ({"name": "a/b"}, ": name: expected a name of letters"),
        ({"methods": None}, ": missing key 'methods'"),
        ({"methods": []}, ": methods: expected at least 1 item"),
        ({"methods": "cosine"}, ": methods: expected a valid list, got 'cosine'"),
        ({"methods": [3]}, ": methods[0]: expected a mapping"),
        ({"methods": ["cosin"]}, ": methods[0]: unknown method 'cosin'; did you mean 'cosine'?"),
        (
            {"methods": [{"name": "cosine", "lable": "x"}]},
            ": methods[0]: unknown key 'lable'; did you mean 'label'?",
        ),
        ({"methods": ["nowhere.py:X"]}, ": methods[0]: no such file"),
        (
            {"methods": ["adapters.py:Good", "adapters.py:Good"]},
            ": methods[1]: 'Good' is listed twice; give one of them another label",
        ),
        ({"materials": ["fake-a", "fake-a"]}, ": materials[1]: 'fake-a' is listed twice"),
        ({"materials": ["fake-a", "leather"]}, ": materials[1]: unknown material 'leather'"),
        (
            {"materials": [{"name": "fake-c", "file": "paint.bsdf"}]},
            ": 'fake-c': file: no such file: paint.bsdf",
        ),
        ({"scenes": ["real-room"]}, ": scenes[0]: unknown"),
        ({"scenes": []}, ": measures[1]: 'clock' needs scenes; there are none"),
        ({"measures": ["prob"]}, ": measures[0]: unknown measure 'prob'; did you mean 'probe'?"),
        (
            {"measures": [{"name": "probe", "row": 3}]},
            ": measures[0]: unknown setting 'row' of measure 'probe'; did you mean 'rows'?",
        ),
        (
            {"measures": [{"name": "probe", "rows": "many"}]},
            ": measures[0]: rows: expected a valid integer, got 'many' (measure 'probe')",
        ),
        ({"seeds": ["0"]}, ": seeds[0]: expected a valid integer, got '0'"),
        ({"seeds": [0, 0]}, ": seeds[1]: '0' is listed twice"),
        ({"baseline": "God"}, ": baseline: 'God' is no method of this suite; did you mean 'Good'?"),
        ({"budget": {"step": 3}}, ": budget: unknown key 'step'; did you mean 'steps'?"),
        ({"budget": {"pool": 0}}, ": budget.pool: expected greater than 0, got 0"),
        ({"report": {"tables": 3}}, ": report.tables: expected a valid list, got 3"),
        (
            {"profiles": {"quick": {"materials": ["fake-c"]}}},
            ": profiles.quick.materials: 'fake-c' is no material of this suite",
        ),
        (
            {"profiles": {"full": {"measures": {"probe": {"rows": 1.5}}}}},
            ": profiles.full.measures.probe: rows: expected a valid integer",
        ),
        (
            {"profiles": {"full": {"override": {"Goo": {}}}}},
            ": profiles.full.override: 'Goo' is no method of this suite; did you mean 'Good'?",
        ),
        (
            {"profiles": {"quick": {"budgte": {}}}},
            ": profiles.quick: unknown key 'budgte'; did you mean 'budget'?",
        ),
        (
            {"profiles": {"quick": {"methods": ["with-state"]}}},
            ": baseline: 'Good' is left out by the profile's methods",
        ),
    ],
)
def test_refused_in_one_line(tmp_path: Path, changes: dict[str, Any], message: str):
    assert refused(tmp_path, **changes).startswith(message)


def test_unknown_profile(tmp_path: Path):
    path = fakes.suite(tmp_path, profiles={"quick": {}, "full": {}})
    with pytest.raises(InputError, match="unknown profile 'fulll'; did you mean 'full'"):
        make_plan(load(path), "fulll")
    with pytest.raises(InputError, match="unknown profile 'full'; known: fast"):
        make_plan(load(fakes.suite(tmp_path)), "full")


def test_missing_suites():
    with pytest.raises(InputError, match="no such suite: tabel2; did you mean 'table2'"):
        load("tabel2")
    with pytest.raises(InputError, match="no such suite: suites/tabel2.yaml"):
        load("suites/tabel2.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: [1", "line 1: not valid YAML"),
        ("- a\n- b\n", "expected a mapping"),
        ("", "expected a mapping"),
        ("name: a\nname: b\n", "line 2: not valid YAML: the key 'name' is given twice"),
        ("name: !!python/object:os.system x\n", "not valid YAML"),
    ],
)
def test_not_a_suite(tmp_path: Path, text: str, message: str):
    path = tmp_path / "s.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        load(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_not_even_text(tmp_path: Path):
    path = tmp_path / "s.yaml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="not a text file"):
        load(path)
    with pytest.raises(InputError, match="is a directory"):
        load(tmp_path)


def test_files_are_found_beside_the_suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    folder = tmp_path / "suite"
    path = fakes.suite(folder, materials=[{"name": "fake-c", "file": "paint.bsdf"}])
    (folder / "paint.bsdf").write_text("x")
    assert load(path).suite.materials[0].rest() == {"file": str(folder / "paint.bsdf")}
    shutil.move(folder / "paint.bsdf", elsewhere / "paint.bsdf")
    assert load(path).suite.materials[0].rest() == {"file": str(elsewhere / "paint.bsdf")}


def test_plan_needs_no_mitsuba_for_fakes(tmp_path: Path):
    # The product is made from descriptions; nothing is constructed.
    assert planning.make_plan(load(fakes.suite(tmp_path))).trials


# --- measures of one method alone --------------------------------------------------------------


def test_measures_of_a_method(tmp_path: Path):
    """The others are taken of it too, or of no method; the baseline has all."""
    coarse = {"name": "adapters.py:Named", "label": "coarse", "measures": ["probe"]}
    plan = plan_of(tmp_path, methods=["adapters.py:Good", coarse], baseline=None)
    assert {t.measure for t in plan.trials if t.method == "coarse"} == {"fit", "probe"}
    assert {t.measure for t in plan.trials if t.method == "Good"} == {"fit", "probe", "clock"}
    assert plan.baseline == "Good"
    coarse["measures"] = ["prob"]
    assert refused(tmp_path, methods=["adapters.py:Good", coarse], baseline=None) == (
        ": methods[1].measures: 'prob' is no measure of this suite; did you mean 'probe'?"
    )
    coarse["measures"] = ["probe"]
    assert ": baseline: 'coarse' has measures of its own" in refused(
        tmp_path, methods=["adapters.py:Good", coarse], baseline="coarse"
    )
    assert "methods: all of them have measures of their own" in refused(
        tmp_path, methods=[coarse], baseline=None
    )
