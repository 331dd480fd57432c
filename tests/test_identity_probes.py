"""Where code changed, a probe tells whether numbers did; what it did not run, it does not judge."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from harness.cli.main import main
from harness.identity import ours
from harness.identity.probe import Probe, computed, difference
from harness.mitsuba_runtime import variant
from tests.planted_edits import CHANGING, PROBED, Edit

variant.use("cpu")

from tests import identity_probes, identity_trials  # noqa: E402  (they need a variant)
from tests.test_identity_edits import changed, edited  # noqa: E402

QUICK = {"render": "adapter", "walks": "material"}
"""By trial the part whose probe is quick and concerns what is edited."""


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return identity_trials.copy_of_tree(tmp_path_factory.mktemp("tree"))


@pytest.fixture(scope="module")
def now() -> dict[str, identity_probes.Told]:
    """Probes by the tree as it is."""
    return {f"{t}:{part}": identity_probes.probe_of(f"{t}:{part}") for t, part in QUICK.items()}


def verdicts(now: dict, later: dict) -> dict[str, str]:
    return {
        name: difference(now[name][0], probe, now[name][1], units, trained=name.startswith("fit:"))
        for name, (probe, units) in later.items()
    }


def chosen(edits: tuple[Edit, ...], file: str, old: str) -> Edit:
    (found,) = [e for e in edits if e.file.endswith(file) and e.old.strip().startswith(old)]
    return found


def test_refactored_code_that_gives_the_same_numbers_keeps_them(tree, now, tmp_path):
    edits = [
        chosen(PROBED, "nets/lobes.py", "scale ="),
        chosen(PROBED, "nets/lobes.py", "return _RANGE"),
        chosen(PROBED, "families/ggx.py", "return 0.5"),
        chosen(PROBED, "core/protocol/disk.py", "return rgb"),
    ]
    with ExitStack() as stack:
        for edit in edits:
            stack.enter_context(edited(tree, edit))
        later = identity_probes.probes_by(tree, tmp_path / "later", now)
    for name, (_, units) in later.items():
        assert units != now[name][1], "the digests saw nothing"
    assert verdicts(now, later) == dict.fromkeys(now, "")


@pytest.mark.slow
def test_changed_numbers_are_told(tree, now, tmp_path):
    edits = [
        chosen(CHANGING, "nets/lobes.py", "return _RANGE"),
        chosen(CHANGING, "families/ggx.py", "return 0.5"),
    ]
    with ExitStack() as stack:
        for edit in edits:
            stack.enter_context(edited(tree, edit))
        later = identity_probes.probes_by(tree, tmp_path / "later", now)
    assert set(verdicts(now, later).values()) == {"the numbers of the probe changed"}


def test_a_probe_does_not_judge_what_it_did_not_run(now):
    probe, units = now["render:adapter"]
    unit = next(u for u in units if u.endswith(":MLP.columns"))
    run, missed = probe.regions[unit]
    assert run and missed, "a branch for GPUs is not run here"
    edited_units = {**units, unit: "0"}
    # A text that is only in the branch: the numbers agree, and tell nothing.
    there = replace(probe, regions={**probe.regions, unit: (run, missed | {"new"})})
    assert "MLP.columns" in difference(probe, there, units, edited_units)
    ran = replace(probe, regions={**probe.regions, unit: (run | {"new"}, missed)})
    assert difference(probe, ran, units, edited_units) == ""
    # Gone from the branch: then it is the old probe that has not run it.
    less = replace(probe, regions={**probe.regions, unit: (run, frozenset())})
    assert "MLP.columns" in difference(probe, less, units, edited_units)


def test_a_number_that_the_probe_does_not_feel_is_no_agreement(now):
    probe, units = now["walks:material"]
    unit = next(u for u in probe.figures if not probe.regions.get(u, (0, 1))[1])
    figures = {**probe.figures, unit: probe.figures[unit] + 1}
    there = replace(probe, figures=figures)
    assert "does not feel" in difference(probe, there, units, {**units, unit: "0"})
    moved = {name: value * (1 + 1e-5) if value.dtype.kind == "f" else value
             for name, value in probe.arrays.items()}  # fmt: skip
    felt = replace(there, arrays=moved)
    assert difference(probe, felt, units, {**units, unit: "0"}) == ""
    more = {name: value * 1.001 for name, value in moved.items()}
    told = difference(probe, replace(there, arrays=more), units, {**units, unit: "0"})
    assert told == "the numbers of the probe changed"
    # Training would amplify it.
    assert difference(probe, felt, units, {**units, unit: "0"}, trained=True)


def test_numbers_are_computed_once_and_their_work_once_more():
    calls = []

    def compute() -> dict[str, np.ndarray]:
        calls.append(len(calls))
        return {"x": np.zeros(1)}

    tree = ours.digests().tree
    assert computed(tree, compute, timed=False).work == "" and len(calls) == 1
    assert computed(tree, compute).work != "" and len(calls) == 3


@pytest.mark.probes
def test_why_there_is_no_probe_is_said(tmp_path, monkeypatch, capsys):
    def no_luck(*_):
        raise ValueError("no luck\nwith it")

    monkeypatch.setattr("harness.runner.probing.Prober.arrays", no_luck)
    suite = {
        "name": "one",
        "materials": ["disney"],
        "methods": ["cosine"],
        "measures": [{"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8}],
        "report": {"tables": [], "figures": []},
    }
    (tmp_path / "one.yaml").write_text(yaml.safe_dump(suite))
    arguments = ["run", str(tmp_path / "one.yaml"), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--executor", "inline"]) == 0
    said = capsys.readouterr().out
    assert "no probe of the method (disney): ValueError: no luck" in said
    assert "with it" not in said


def test_a_time_needs_the_same_work(now):
    probe, units = now["walks:material"]
    unknown = replace(probe, work="")
    assert difference(probe, unknown, units, units) == ""
    assert "not known" in difference(unknown, unknown, units, units, timed=True)
    other = replace(probe, work="other")
    assert difference(probe, other, units, units) == ""
    assert difference(probe, other, units, units, timed=True) == "the work that is timed changed"


def test_a_probe_is_the_same_after_it_was_stored(now):
    probe, units = now["walks:material"]
    again = Probe.unpacked(probe.packed())
    assert (again.work, again.tried) == (probe.work, probe.tried)
    assert dict(again.regions) == dict(probe.regions)
    assert difference(probe, again, units, units, timed=True) == ""


@pytest.mark.slow
@pytest.mark.parametrize("edit", CHANGING, ids=lambda e: f"{e.file}:{e.old[:20]}")
def test_no_changed_number_passes_a_probe(edit, tree, tmp_path):
    before = identity_trials.digests_of(tree, [edit.trial])
    with edited(tree, edit):
        parts = [text.partition(": ")[2] for text in changed(before, tree, [edit.trial])]
        asked = [f"{edit.trial}:{part}" for part in parts]
        later = identity_probes.probes_by(tree, tmp_path / "later", asked)
    assert any(verdicts({name: before_edits(name) for name in asked}, later).values())


@cache
def before_edits(asked: str) -> identity_probes.Told:
    """The probe ``asked`` for by the tree as it is."""
    return identity_probes.probe_of(asked)
