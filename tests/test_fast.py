"""``--profile fast``: rough numbers of a part of any suite."""

from __future__ import annotations

import pytest

from harness.core.protocol.errors import InputError
from harness.mitsuba_runtime import variant
from harness.suite.load import from_data, load, names
from harness.suite.plan import make_plan

SMALL = {
    "name": "x",
    "materials": ["suede"],
    "methods": ["cosine", {"name": "improved-baseline", "budget": {"steps": 20}}],
    "scenes": ["uniform-sphere"],
    "measures": [{"name": "equal-spp", "spp": 4}],
    "resolution": 16,
}


OF_SUITES = ("smoke", "effects", "table1")


@pytest.mark.parametrize(
    "name",
    [name if name in OF_SUITES else pytest.param(name, marks=pytest.mark.slow) for name in names()],
)
def test_every_suite_has_a_fast_profile(name: str):
    """A part of it, no setting above that of its quick profile, and said to be rough."""
    variant.use("cpu")  # measures that render name Mitsuba's classes
    try:
        loaded = load(name)
    except InputError as missing:
        assert "no such" in str(missing)  # it wants a folder or files of the user's own
        return
    usual, plan = make_plan(loaded), make_plan(loaded, "fast")
    assert "rough numbers" in plan.title and plan.note in plan.title and not usual.note
    for key in ("material", "scene"):
        assert len(plan.labels(key)) <= 1 and set(plan.labels(key)) <= set(usual.labels(key))
    assert plan.labels("measure") == usual.labels("measure")
    settings = {t.measure: t.settings for t in usual.trials}
    for trial in plan.trials:
        assert trial.budget.steps <= 100
        for key, value in trial.settings.items():
            before = settings[trial.measure][key]
            if isinstance(value, int | float) and before is not None:
                assert value <= before, (trial.measure, key)


def test_what_is_smaller_already_stays():
    variant.use("cpu")
    plan = make_plan(from_data(SMALL), "fast")
    assert plan.trials[-1].settings["spp"] == 4 and plan.trials[-1].settings["resolution"] == 16
    assert plan.trials[-1].budget.steps == 20


def test_a_fit_that_is_there_is_taken():
    """It costs nothing, and is better than a short one."""
    variant.use("cpu")
    made = from_data({**SMALL, "budget": {"steps": 5000}, "methods": ["cosine", "two-lobe"]})
    plan = make_plan(made, "fast", fitted=lambda trial: trial.method == "two-lobe")
    assert {t.method: t.budget.steps for t in plan.trials} == {"cosine": 100, "two-lobe": 5000}


def test_a_profile_of_that_name_is_the_suites():
    variant.use("cpu")
    made = from_data({**SMALL, "profiles": {"fast": {"seeds": [0, 1, 2]}}})
    plan = make_plan(made, "fast")
    assert {t.seed for t in plan.trials} == {0, 1, 2} and not plan.note
