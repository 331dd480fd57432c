"""Every suite that ships says where the code of its trials begins."""

from __future__ import annotations

import pytest

from harness.mitsuba_runtime import variant
from harness.runner.validity import Validity
from harness.suite.load import load, names
from harness.suite.plan import make_plan

variant.use("cpu")

NEEDS_FILES = {"measured"}
"""Suites on files of the user's own."""


@pytest.mark.parametrize("name", sorted(set(names()) - NEEDS_FILES))
def test_every_trial_has_digests_of_its_parts(name: str):
    plan = make_plan(load(name))
    validity = Validity(plan, {})
    for trial in plan.trials:
        parts = validity.parts(trial)
        assert {"adapter", "material", "measure", "versions"} <= parts.keys()
        assert ("scene" in parts) == bool(trial.scene)
        assert ("training" in parts) == (trial.measure == "fit")
