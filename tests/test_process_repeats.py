"""Timings over processes: pooled rightly, and really taken in processes of their own."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from rich.console import Console
from scipy import stats

from harness import load_results
from harness.analysis.process_pooling import joined, pooled, split, together
from harness.analysis.records import registry as records
from harness.analysis.results import Results
from harness.core.protocol.method import Budget
from harness.core.record import Numbers, Raw, Record
from harness.measures import registry as measures
from harness.measures.base import Outcome
from harness.mitsuba_runtime.variant import use
from harness.runner import process_repeats
from harness.runner.jobs import Jobs
from harness.runner.run import Options, run
from harness.stats.intervals import median_interval
from harness.suite.load import load
from harness.suite.plan import make_plan
from harness.suite.trials import Trial
from tests.test_stats_coverage import check

TIMES = ("seconds-per-spp",)


def one(ratio: float, seconds: float = 1.0, disturbed: float = 0.0) -> Outcome:
    """What one process found."""
    return Outcome(
        records=[
            Record("batch", 64.0, unit="1"),
            Record("seconds-per-spp", seconds, 0.9 * seconds, 1.1 * seconds, "s"),
            Record("time-ratio", ratio, 0.99 * ratio, 1.01 * ratio, "1"),
            Record("metering-overhead", ratio - 2, unit="1"),
            Record("disturbed", disturbed, unit="1"),
        ],
        arrays={
            "seconds": np.array([seconds, 2.0]),
            "round_spp": np.array(3),
            "batch": np.array(64),
        },
    )


def numbers(*outcomes: Outcome, tolerance: float = 0.1) -> Numbers:
    """Pooled."""
    return pooled([Numbers(o.records, o.reason) for o in outcomes], tolerance, TIMES)


def test_values_and_intervals() -> None:
    ratios = np.array([1.98, 2.0, 2.04])
    found = numbers(*map(one, ratios))
    by = {r.metric: r for r in found.records}
    assert by["batch"] == Record("batch", 64.0, unit="1")
    assert by["seconds-per-spp"].ci_low == 0.9  # the same in all: nothing to pool
    logs = np.log(ratios)
    half = stats.t.ppf(0.975, 2) * logs.std(ddof=1) / math.sqrt(3)
    assert by["time-ratio"].value == pytest.approx(math.exp(logs.mean()))
    assert by["time-ratio"].ci_high == pytest.approx(math.exp(logs.mean() + half))
    assert by["metering-overhead"].value == pytest.approx(np.mean(ratios - 2))  # of both signs
    assert by["disturbed"].value == 0
    assert found.reason == ""


def test_raw_data_of_each_process_are_kept() -> None:
    arrays = together([one(2.0, seconds).arrays for seconds in (1.0, 3.0, 5.0)])
    assert set(arrays) == {f"p{i}/{k}" for i in range(3) for k in ("seconds", "round_spp", "batch")}
    parts = split(Raw(arrays, together([{}, {"no_peak": "why"}, {}]), {"tolerance": 0.1}))
    assert parts is not None and [p.arrays["seconds"].tolist() for p in parts] == [
        [1, 2],
        [3, 2],
        [5, 2],
    ]
    assert [p.documents for p in parts] == [{}, {"no_peak": "why"}, {}]
    assert split(Raw(one(2.0).arrays)) is None
    flat = joined(arrays)
    assert flat["seconds"].tolist() == [1, 2, 3, 2, 5, 2]
    assert flat["round_spp"].tolist() == [3, 3, 3] and len(flat["processes"]) == 3
    assert joined(one(2.0).arrays).keys() == one(2.0).arrays.keys()


def test_more_than_ten_processes_keep_their_order() -> None:
    arrays = together([{"seconds": np.array([float(i)])} for i in range(12)])
    assert joined(dict(sorted(arrays.items())))["seconds"].tolist() == list(range(12))


def test_disturbed_is_what_the_pooled_interval_says() -> None:
    narrow = numbers(*(one(r, disturbed=1.0) for r in (1.99, 2.0, 2.01)))
    assert narrow.records[-1] == Record("disturbed", 0.0, unit="1")
    wide = numbers(*map(one, (1.8, 2.0, 2.2)))
    assert wide.records[-1] == Record("disturbed", 1.0, unit="1")
    assert wide.reason.startswith("disturbed: interval wider than 10% over 3 processes: time-ratio")


def test_other_reasons_of_a_disturbed_process_are_kept() -> None:
    first = one(1.99, disturbed=1.0)
    first.reason = "disturbed: interval wider than 10%: render 12%, sample 11%; no peak here"
    assert numbers(first, one(2.0), one(2.01)).reason == "no peak here"


def test_the_baseline_is_judged_by_its_times() -> None:
    def base(seconds: float) -> Outcome:
        found = one(1.0, seconds)
        found.records[2] = Record("time-ratio", 1.0, 1.0, 1.0, "1")
        return found

    assert numbers(*map(base, (1.0, 1.01)), tolerance=0.2).records[-1].value == 0
    found = numbers(*map(base, (1.0, 1.3)), tolerance=0.2)
    assert found.records[-1].value == 1
    assert "seconds-per-spp" in found.reason


def test_a_failure_stands_for_all(monkeypatch) -> None:
    failed = Outcome("nonfinite", "seconds is nan")
    found, _ = played(monkeypatch, iter([one(2.0), failed]), processes=2)
    assert found == [failed]


def test_coverage_where_processes_differ() -> None:
    """2 % from process to process, 1 % from round to round; the rounds of one cannot know."""
    rng, trials, held, alone = np.random.default_rng(2), 600, 0, 0
    for _ in range(trials):
        rounds = np.exp(0.02 * rng.standard_normal((5, 1)) + 0.01 * rng.standard_normal((5, 8)))
        found = numbers(*(one(float(np.median(r))) for r in rounds))
        ratio = next(r for r in found.records if r.metric == "time-ratio")
        held += ratio.ci_low <= 1 <= ratio.ci_high
        first = median_interval(rounds[0])
        alone += first.low <= 1 <= first.high
    check(held / trials, trials)
    assert alone / trials < 0.7


def played(monkeypatch, found: Iterator[Outcome], **settings) -> tuple[list[Outcome], list[dict]]:
    """:func:`process_repeats.run` of one trial whose processes find ``found``, and what each was
    asked."""
    use("cpu")
    asked = []

    def in_process(question, note):
        asked.append(question.trials[0].settings)
        return [next(found)]

    monkeypatch.setattr(process_repeats, "_in_process", in_process)
    trial = Trial("h", {}, "s", "m", "a", "", "cost", 0, settings={"tolerance": 0.1, **settings})
    jobs = Jobs("cosine", {"": None}, print)
    # With the settings of ``cost``, and records of its own.
    measure = type("Fake", (measures.load("cost"),), {"name": "fake-cost"})()
    return process_repeats.run(measure, [trial], jobs, lambda text: None), asked


def test_processes_go_on_while_an_interval_is_wide(monkeypatch) -> None:
    def asked(ratios: list[float], **limits: int) -> int:
        return len(played(monkeypatch, map(one, ratios), **limits)[1])

    wide, narrow = [1.0, 2.0] * 4, [2.0, 2.01] * 4
    assert asked(narrow, processes=2, max_processes=5) == 2
    assert asked(wide, processes=2, max_processes=5) == 5
    assert asked(wide, processes=3) == 3
    assert asked([1.99, 2.2, *[2.0, 2.01] * 4], processes=2, max_processes=8) < 8


def test_cold_starts_are_of_the_first_process(monkeypatch) -> None:
    asked = played(monkeypatch, map(one, [2.0, 2.1]), processes=2, starts=3)[1]
    assert [settings["starts"] for settings in asked] == [3, 0]


def test_later_processes_have_the_sizes_of_the_first(monkeypatch) -> None:
    """The clock chose them once: a batch of another size takes another time for each row."""
    asked = played(monkeypatch, map(one, [2.0, 2.1, 2.0]), processes=3)[1]
    assert [(s.get("rows"), s.get("spp")) for s in asked] == [(None, None), (64, 3), (64, 3)]


def test_what_the_first_process_alone_knows_is_kept() -> None:
    first = one(2.0)
    first.records.insert(0, Record("load-seconds", 1.0, 0.5, 1.5, "s"))
    first.arrays["load_seconds"] = np.array([1.0, 1.2])
    found = numbers(first, one(2.02))
    assert found.records[0] == Record("load-seconds", 1.0, 0.5, 1.5, "s")
    flat = joined(together([first.arrays, one(2.02).arrays]))
    assert flat["load_seconds"].tolist() == [1.0, 1.2]


@pytest.mark.slow
def test_coverage_where_wide_intervals_ask_for_more(monkeypatch) -> None:
    """8 to 16 processes that differ by 6 %: half of the runs go on beyond the eighth."""
    rng, trials, held, longer = np.random.default_rng(3), 300, 0, 0
    for _ in range(trials):
        ratios = np.exp(0.06 * rng.standard_normal(16)).tolist()
        found, asked = played(monkeypatch, map(one, ratios), processes=8, max_processes=16)
        ratio = next(r for r in found[0].records if r.metric == "time-ratio")
        held += ratio.ci_low <= 1 <= ratio.ci_high
        longer += len(asked) > 8
    check(held / trials, trials)
    assert 0.3 < longer / trials < 0.7


ADAPTER = '''
import os
import torch
from harness import DiskSample, Method
from harness import BudgetExceeded, square_to_disk


class Good(Method):
    """Uniform on the disk."""

    def sample(self, condition, u):
        return DiskSample(square_to_disk(u[:, :2]), torch.full((len(u),), 0.31830988618))

    def pdf(self, condition, wo):
        return torch.full((len(wo),), 0.31830988618)


class Dies(Good):
    """Only in a process that is not the one that fitted it."""

    trouble = RuntimeError

    def fit(self, material, budget, generator):
        report = super().fit(material, budget, generator)
        self.home = torch.tensor([os.getpid()])
        return report

    def state_dict(self):
        return {"home": self.home}

    def load_state_dict(self, state):
        self.home = state["home"]

    def pdf(self, condition, wo):
        if int(self.home) != os.getpid():
            raise self.trouble("far from home")
        return super().pdf(condition, wo)


class Late(Dies):
    """The same, and a timeout."""

    trouble = BudgetExceeded
'''


@pytest.mark.slow
def test_every_repeat_is_a_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worker_processes: None
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))  # not to wait for others' timings
    (tmp_path / "adapters.py").write_text(ADAPTER)
    suite = {
        "name": "repeated",
        "materials": ["suede"],
        "methods": ["cosine", "adapters.py:Good", "adapters.py:Dies", "adapters.py:Late"],
        "baseline": "cosine",
        "measures": ["throughput"],
        "profiles": {
            "quick": {
                "measures": {
                    "throughput": {"processes": 2, "batch": 256, "rounds": 6, "least_seconds": 1e-4}
                }
            }
        },
    }
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump(suite))
    text, out = io.StringIO(), tmp_path / "out"
    plan = make_plan(load(tmp_path / "suite.yaml"))
    settings = next(t.settings for t in plan.trials if t.measure == "throughput")
    assert run(plan, out, Options(), Console(file=text, width=200)) == 1
    rows = load_results(out)
    rows = rows[rows["measure"] == "throughput"]
    dies = rows[rows["method"] == "Dies"]
    assert dies["status"].item() == "error"
    assert dies["reason"].item() == "RuntimeError: in a fresh process: RuntimeError: far from home"
    timeouts = rows[rows["method"] == "Late"]
    assert timeouts["status"].tolist() == ["timeout"]
    assert timeouts["reason"].tolist() == ["in a fresh process: far from home"]
    good = rows[(rows["method"] == "Good") & (rows["metric"] == "sample-time-ratio")]
    assert good["status"].item() == "ok"
    assert good["ci_low"].item() < good["value"].item() < good["ci_high"].item()
    stored = Results.load(out).stored(good["trial"].item())
    arrays = joined(stored.arrays)
    assert len(arrays["processes"]) == 2 and len(arrays["sample_seconds"]) >= 12
    again = records.numbers("throughput", Raw(stored.arrays, stored.documents, settings))
    assert again is not None and [r.value for r in again.records] == [
        r["value"] for r in stored.records
    ]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU to be refused no more")
def test_a_process_is_on_the_device_of_its_trial() -> None:
    """Made ready before anything else: a process of its own knows nothing of its parent's."""
    budget = Budget(device="cuda")
    trial = Trial("h", {}, "s", "m", "a", "", "cost", 0, settings={}, budget=budget)
    jobs = Jobs("cosine", {"": None}, print)
    with pytest.raises(RuntimeError, match="in a fresh process: InputError: device 'cuda' needs"):
        process_repeats.run(measures.make("cost"), [trial], jobs, lambda text: None)
