"""The measure, the suite, the table and the figure of numerical stability."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from harness import load_results
from harness.checks.catalogue import CATALOGUE
from harness.checks.finding import Finding
from harness.checks.run import CASE_ALARM, FALSE_ALARM
from harness.core.jsonfile import dumps
from harness.core.protocol.errors import InputError, Unsupported
from harness.core.protocol.method import Budget
from harness.identity.ours import digests
from harness.measures import registry as measures
from harness.measures import stability
from harness.measures.base import Outcome
from harness.report import write as reports
from harness.runner.run import Options
from harness.runner.run import run as run_plan
from harness.suite import source_parts
from harness.suite.load import load
from harness.suite.plan import make_plan
from tests.measuring import run as run_measure

# --- the measure ---------------------------------------------------------------------------------


def found(name: str, verdict: str = "pass", number: float | None = None, **more: Any) -> Finding:
    return Finding(name, "case", verdict, f"{name} says {verdict}", number=number, **more)


def case_of(name: str, material: str = "suede") -> SimpleNamespace:
    return SimpleNamespace(name=name, group="lobe", about=f"about {name}", material=material)


@pytest.fixture
def catalogue(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Three cases in place of the catalogue; what each finds, or raises, is in ``answers``."""
    known = {c.name: c for c in (case_of("one"), case_of("other", "rim-lobe"), case_of("two"))}
    answers: dict[str, Any] = {name: [found("integral")] for name in known}
    asked: list[tuple[str, float, int]] = []

    def run_case(fitted, blank, material, case, seed, *, device, alpha):
        asked.append((case.name, alpha, seed))
        if isinstance(answers[case.name], Exception):
            raise answers[case.name]
        return answers[case.name]

    monkeypatch.setattr(stability, "CATALOGUE", known)
    monkeypatch.setattr(stability, "run_case", run_case)
    return {"answers": answers, "asked": asked}


def measured(material: str = "suede", **settings: Any) -> Outcome:
    job = SimpleNamespace(
        method=object(),
        make=object,
        material=SimpleNamespace(name=material),
        seed=7,
        budget=Budget(),
        settings=measures.settings("stability", settings),
    )
    (outcome,) = run_measure("stability", [job], print)
    return outcome


def stored_findings(outcome: Outcome) -> dict[str, Any]:
    """As a store gives them back."""
    return json.loads(dumps(outcome.documents))[stability.FINDINGS]


def numbers(outcome: Outcome) -> dict[str, float]:
    return {record.metric: record.value for record in outcome.records}


def test_only_the_cases_of_the_material_are_run(catalogue):
    outcome = measured()
    assert outcome.status == "ok" and numbers(outcome) == {"one": 0.0, "two": 0.0}
    assert catalogue["asked"] == [("one", CASE_ALARM, 7), ("two", CASE_ALARM, 7)]
    assert numbers(measured("rim-lobe")) == {"other": 0.0}
    assert numbers(measured(cases=["two"])) == {"two": 0.0}
    with pytest.raises(Unsupported, match="no hard case .* asks for brocade"):
        measured("brocade")
    with pytest.raises(Unsupported):
        measured(cases=["other"])


def test_the_worst_verdict_counts_and_the_worst_numbers_are_recorded(catalogue):
    catalogue["answers"]["one"] = [
        found("weights", number=0.4, unit="efficiency"),
        found("weights", "degraded", 0.002, unit="efficiency"),
        found("coverage", number=1e-6, unit="1"),
        found("coverage", number=3e-5, unit="1"),
        found("tail-index", number=5.0),
        found("tail-index", number=3.0),
        found("largest-weight", number=math.inf),
        found("invalid", number=math.nan),
        found("gradients", "skip"),
    ]
    catalogue["answers"]["two"] = [found("weights", "degraded", 0.005), found("integral", "fail")]
    outcome = measured()
    assert numbers(outcome) == {
        "one": 1.0,
        "one/efficiency": 0.002,
        "one/lost": 3e-5,
        "one/tail-index": 3.0,
        "one/largest-weight": math.inf,
        "two": 2.0,
        "two/efficiency": 0.005,
    }
    units = {record.metric: record.unit for record in outcome.records}
    assert (units["one"], units["one/efficiency"]) == ("verdict", "efficiency")


def test_an_adapter_that_raises_fails_the_case_and_not_the_trial(catalogue):
    catalogue["answers"]["one"] = ValueError("two\nlines")
    outcome = measured()
    assert outcome.status == "ok" and numbers(outcome) == {"one": 2.0, "two": 0.0}
    stored = stored_findings(outcome)["cases"]
    assert stored[0]["findings"][0]["text"] == "raised ValueError: two lines"


def test_a_case_that_does_not_apply_has_a_reason_and_no_number(catalogue):
    catalogue["answers"]["one"] = [found("state", "skip")]
    catalogue["answers"]["two"] = []
    outcome = measured()
    assert outcome.records == []
    stored = stored_findings(outcome)["cases"]
    assert [case["verdict"] for case in stored] == ["skip", "skip"]
    assert [case["findings"][0]["text"] for case in stored] == [
        "state says skip",
        "no property applies",
    ]


def test_findings_are_stored_with_their_place_and_their_worst_input(catalogue):
    worst = {"wo": "(0.6, 0.8)", "got": "nan"}
    catalogue["answers"]["two"] = [found("pdf-finite", "fail", math.nan, worst=worst)]
    stored = stored_findings(measured())
    assert stored["case_alarm"] == CASE_ALARM
    first, second = stored["cases"]
    assert (first["position"], second["position"]) == (0, 2)
    assert (second["case"], second["group"], second["about"]) == ("two", "lobe", "about two")
    assert second["findings"][0]["worst"] == worst and second["findings"][0]["number"] == "nan"


def test_an_unknown_case_is_refused_with_the_nearest(catalogue):
    with pytest.raises(InputError, match="no hard case 'oone' .did you mean 'one'"):
        measures.settings("stability", {"cases": ["oone"]})
    with pytest.raises(InputError, match="cases"):
        measures.settings("stability", {"cases": "one"})


# --- the suite -----------------------------------------------------------------------------------


def test_the_suite_covers_the_catalogue_and_the_methods_of_other_suites():
    """All of ``table2-procedural`` and of ``table2``, and the random walk, which families have."""
    plan = make_plan(load("stability"))
    assert set(plan.labels("material")) == {case.material for case in CATALOGUE.values()}
    expected = {"random-walk"}
    for name in ("table2-procedural", "table2"):
        expected |= {method.name for method in load(name).suite.methods}
    assert {trial.method_name for trial in plan.trials} == expected
    assert 1 - (1 - CASE_ALARM) ** (len(plan.labels("method")) * len(CATALOGUE)) < FALSE_ALARM
    trials = [trial for trial in plan.trials if trial.measure == "stability"]
    assert len(trials) == len(plan.labels("material")) * len(plan.labels("method"))
    assert not any(trial.timed for trial in trials)


def test_the_numbers_stand_on_the_checks():
    known = digests()
    part = source_parts.measure(known.tree, measures.load("stability"))
    units = known.of({"measure": part})["measure"].units
    modules = {unit.partition(":")[0] for unit in units}
    for name in ("catalogue", "run", "weights", "quadrature"):
        assert f"harness.checks.{name}" in modules


def test_a_run_gives_a_verdict_on_a_real_case(tmp_path: Path):
    (tmp_path / "tiny.yaml").write_text(
        "name: tiny\nmaterials: [constant]\nmethods: [cosine]\nmeasures: [stability]\n"
        "report: {tables: [stability], figures: [heatmap]}\n"
    )
    plan = make_plan(load(tmp_path / "tiny.yaml"))
    assert run_plan(plan, tmp_path / "out", Options(), Console(file=io.StringIO())) == 0
    frame = load_results(tmp_path / "out")
    names = [name for name, case in CATALOGUE.items() if case.material == "constant"]
    verdicts = frame[frame["metric"].isin(names)]
    assert names and list(verdicts["value"]) == [0.0] * len(names)
    # Cosine is exact for a constant reflectance: every weight is the same.
    efficiency = frame[frame["metric"] == f"{names[0]}/efficiency"]["value"]
    assert efficiency.item() == pytest.approx(1.0, abs=1e-5)
    assert {path.stem for path in reports.load(tmp_path / "out").write()} >= {
        "index",
        "stability",
        "heatmap",
    }
