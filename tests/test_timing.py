"""Timing: on a clock of our own, so that no test is decided by how fast this machine is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.disturbed import mark
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.core.record import Record
from harness.measures import registry as measures
from harness.measures import timing
from harness.measures.base import Job, Outcome
from harness.measures.deadline_render import DeadlineRender, render_to_deadlines
from harness.measures.timing import Contender, RoundSettings, Timings, interleave, settle
from harness.stats.intervals import Interval
from tests.measuring import run
from tests.planted import Correct, Plaster


class Clock:
    """Seconds that pass only when told to, on a machine that drifts and is noisy."""

    def __init__(self, noise: float = 0.01, drift: float = 0.5, seed: int = 0, pace: float = 1.0):
        self.seconds, self.noise, self.drift, self.pace = 100.0, noise, drift, pace
        self.random = np.random.default_rng(seed)

    def work(self, seconds: float) -> float:
        """Work that would take ``seconds`` on a quiet machine; what it takes on this one."""
        slow = 1 + self.drift * math.sin(self.pace * self.seconds)
        taken = seconds * slow * math.exp(self.noise * self.random.normal())
        self.seconds += taken
        return taken

    def now(self, device: str = "cpu") -> float:
        """In place of :func:`harness.measures.timing.now`."""
        return self.seconds


class Paced(Correct):
    """A millisecond a call on the clock, whatever the rows."""

    name = "paced"
    clock: Clock

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        self.clock.work(1e-3)
        return super().sample(condition, u)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Ten microseconds, also where ``sample`` asks for it."""
        self.clock.work(1e-5)
        return super().pdf(condition, wo)


class Twice(Method):
    """Calls the sampler inside twice and uses one result: exactly 2 x slower."""

    name = "twice"

    def __init__(self, inner: Method):
        self.inner = inner

    def fit(self, material: Any, budget: Budget, generator: torch.Generator) -> Any:
        """See :meth:`Method.fit`."""
        return self.inner.fit(material, budget, generator)

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        thrown_away = self.inner.sample(condition, u)
        # Forced: a lazy result that nobody reads would cost nothing.
        assert float(thrown_away.pdf.sum()) >= 0
        return self.inner.sample(condition, u)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        self.inner.pdf(condition, wo)
        return self.inner.pdf(condition, wo)


def job(method: Method, baseline: bool, **given: Any) -> Job:
    """For the measure throughput."""
    material = Plaster()
    method.fit(material, Budget(), torch.Generator().manual_seed(0))
    return Job(
        trial=None,
        material=material,
        method=method,
        scene=None,
        seed=0,
        generator=torch.Generator().manual_seed(0),
        settings=measures.settings("throughput", given),
        budget=Budget(),
        make=lambda: method,
        baseline=baseline,
    )


def throughput(method: Method, base: Method, **given: Any) -> list[Outcome]:
    """Of ``method`` and of the baseline ``base``."""
    jobs = [job(method, False, **given), job(base, True, **given)]
    return run("throughput", jobs)


def interval(outcome: Outcome, metric: str) -> tuple[float, float, float]:
    """Value and ends."""
    found = {r.metric: r for r in outcome.records}[metric]
    return found.value, found.ci_low, found.ci_high


def contenders(*work: Callable[[int], float], units: float = 1.0) -> list[Contender]:
    """The first is everybody's rival."""
    return [Contender(f"c{i}", once, units, None if i == 0 else 0) for i, once in enumerate(work)]


def ratio(timings: Timings, index: int) -> Interval:
    """Of one contender's times to its rival's."""
    return timings.of(index).ratio()


def width(timings: Timings, index: int) -> float:
    """Of the interval that decides."""
    return timings.of(index).width()


def marked(timings: Timings, *indices: int) -> tuple[Record, str]:
    """As a trial of these contenders would be."""
    return mark([timings.of(i) for i in indices], timings.tolerance)


def quiet(text: str) -> None:
    """Says nothing."""


# --- the planted adapter ---------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_an_adapter_twice_as_slow_reads_two(monkeypatch, seed):
    """On a machine whose speed swings by a factor of three while it is measured."""
    # Eleven rounds see a good part of the swing: the first takes 1.6 x as long as the last.
    clock = Clock(seed=seed, pace=80)
    monkeypatch.setattr(timing, "now", clock.now)
    Paced.clock = clock
    # Each call a slice of its own: the machine's swing here is as fast as fifty of them.
    given = {"batch": 64, "rounds": 11, "max_rounds": 11, "least_seconds": 0.0}
    given["max_seconds"] = 10.0
    slow, base = throughput(Twice(Paced()), Paced(), **given)
    for metric in ("sample-time-ratio", "pdf-time-ratio"):
        value, low, high = interval(slow, metric)
        assert low <= 2 <= high and (high - low) / value <= 0.1
        assert value == pytest.approx(2, rel=0.02)
        assert interval(base, metric) == (1, 1, 1)
    assert interval(slow, "disturbed")[0] == 0 and slow.reason == ""
    # The drift does not cancel in the baseline's own seconds, and the record says so.
    assert interval(base, "disturbed")[0] == 1 and "sample" in base.reason
    assert len(slow.arrays["sample_seconds"]) == 11


@pytest.mark.slow
def test_short_calls_are_repeated_until_a_round_is_long(monkeypatch):
    """Fifty of a millisecond; what a row costs does not depend on it, and its noise does."""
    widths = []
    for least in (0.0, 0.05):
        clock = Clock(noise=0.05, drift=0)
        monkeypatch.setattr(timing, "now", clock.now)
        Paced.clock = clock
        given = {"batch": 64, "rounds": 12, "max_rounds": 12, "least_seconds": least}
        given["slices"] = 1
        _, base = throughput(Paced(), Paced(), **given)
        value, low, high = interval(base, "samples-per-second")
        assert value == pytest.approx(64 / 1.01e-3, rel=0.05)
        # Of one call of the batch, however many there were.
        assert base.arrays["sample_seconds"] == pytest.approx(1.01e-3, rel=0.2)
        widths.append((high - low) / value)
    assert widths[1] < widths[0] / 3


@pytest.mark.slow
def test_an_adapter_twice_as_slow_reads_two_on_this_machine():
    """With the real clock: a record that is not marked holds what it says."""
    inner = Correct()
    for _ in range(3):
        slow, _ = throughput(Twice(inner), inner, batch=65_536, rounds=21, max_rounds=63)
        value, low, high = interval(slow, "sample-time-ratio")
        if not interval(slow, "disturbed")[0]:
            break
    else:
        pytest.skip(f"this machine is too busy to time anything: {slow.reason}")
    # The interval misses one time in twenty; a second hundredth is cache and call overhead.
    assert low - 0.02 <= 2 <= high + 0.02, (value, low, high)


def test_intervals_of_the_ratio_hold_two_as_often_as_they_say():
    """In 400 runs of 12 rounds each: the drift is in both times and cancels."""
    runs, held = 400, 0
    settings = RoundSettings(rounds=12, max_rounds=12)
    for seed in range(runs):
        clock = Clock(noise=0.05, seed=seed)
        pair = contenders(lambda _, c=clock: c.work(0.02), lambda _, c=clock: c.work(0.04))
        _, low, high = interleave(pair, settings, quiet).of(1).ratio()
        held += low <= 2 <= high
    # 95 % of the median's interval, less what drift within a round does; 3.5 standard errors.
    assert held / runs == pytest.approx(0.95, abs=3.5 * math.sqrt(0.95 * 0.05 / runs))


# --- rounds ----------------------------------------------------------------------------


def test_nobody_always_follows_the_same():
    """What is left of the one before in caches and memory is in everybody's time now and then."""
    before: dict[int, list[int]] = {k: [] for k in range(12)}
    order: list[int] = []
    once = [lambda number, k=k: (order.append(k), 1.0)[1] for k in range(12)]
    interleave(contenders(*once), RoundSettings(rounds=8, max_rounds=8), quiet)
    for one, other in pairwise(order):
        before[other].append(one)
    assert all(len(set(found)) >= 3 for found in before.values())


def test_rounds_are_interleaved_and_rotate():
    """Each goes first equally often, and nobody is timed twice in a round."""
    order: list[tuple[int, int]] = []

    def once(index: int) -> Callable[[int], float]:
        return lambda number: (order.append((number, index)), 1.0)[1]

    settings = RoundSettings(rounds=6, max_rounds=6)
    timings = interleave(contenders(*map(once, range(3))), settings, quiet)
    assert [n for n, _ in order] == sorted([*range(6)] * 3)
    firsts = [order[3 * n][1] for n in range(6)]
    assert sorted(firsts) == [0, 0, 1, 1, 2, 2]
    assert all({i for n, i in order if n == number} == {0, 1, 2} for number in range(6))
    assert timings.loadavg.shape == (3,) and (timings.loadavg >= 0).all()


def test_slices_alternate_with_the_rival_s():
    """Who goes first too; the rival's own slices are others, and so are its seconds."""
    order: list[int] = []

    def once(index: int) -> Callable[[int], float]:
        return lambda number: (order.append(index), len(order))[1]

    pair = [Contender("base", once(0), slices=2), Contender("other", once(1), 1.0, 0, slices=3)]
    timings = interleave(pair, RoundSettings(rounds=1, max_rounds=1), quiet)
    assert order == [0, 0, 0, 1, 1, 0, 0, 1]
    assert timings.seconds(0) == [1.5] and timings.seconds(1) == [(4 + 5 + 8) / 3]
    assert timings.rival_seconds(1) == [(3 + 6 + 7) / 3]


def test_slices_see_the_same_machine():
    """Whose speed changes within a round: by half, up and down every tenth of a second."""
    widths = {}
    for slices in (1, 10):
        clock = Clock(noise=0.01, drift=0.5, pace=60)
        work = [lambda _, s=s, c=clock, n=slices: c.work(s / n) for s in (0.05, 0.1)]
        pair = contenders(*work)
        if slices > 1:
            pair = [replace(one, slices=slices) for one in pair]
        timings = interleave(pair, RoundSettings(rounds=15, max_rounds=15), quiet)
        assert ratio(timings, 1).low <= 2 <= ratio(timings, 1).high
        widths[slices] = width(timings, 1)
    assert widths[10] < widths[1] / 3


def test_more_rounds_need_no_rival_that_is_beside():
    clock, noisy = Clock(noise=0.002, drift=0), np.random.default_rng(3)
    pair = [
        Contender("baseline", lambda _: clock.work(1), slices=2),
        Contender("wide", lambda _: 2 * math.exp(0.2 * noisy.normal()), rival=0, slices=2),
    ]
    timings = interleave(pair, RoundSettings(rounds=6, max_rounds=400), quiet)
    assert len(timings.seconds(0)) == 6 < len(timings.seconds(1)) == len(timings.rival_seconds(1))


def test_quiet_timings_end_after_the_planned_rounds():
    """And are not marked."""
    clock = Clock(noise=0.01, drift=0)
    pair = contenders(lambda _: clock.work(1), lambda _: clock.work(3), units=10)
    timings = interleave(pair, RoundSettings(rounds=8, max_rounds=100), quiet)
    assert len(timings.seconds(0)) == len(timings.seconds(1)) == 8
    assert timings.median(1).value == pytest.approx(0.3, rel=0.02)
    record, reason = marked(timings, 0, 1)
    assert (record.metric, record.value, reason) == ("disturbed", 0, "")


def test_more_rounds_for_the_wide_ones_only():
    """With their rival beside them in the same rounds; the others are left alone."""
    clock = Clock(noise=0.002, drift=0)
    noisy = np.random.default_rng(3)
    three = contenders(
        lambda _: clock.work(1),
        lambda _: clock.work(2),
        lambda _: 3 * math.exp(0.08 * noisy.normal()),
    )
    timings = interleave(three, RoundSettings(rounds=6, max_rounds=400), quiet)
    taken = [len(timings.seconds(i)) for i in range(3)]
    assert taken[1] == 6 and taken[0] == taken[2] and 6 < taken[2] < 400
    assert timings.rival_seconds(2).shape == (taken[2],)
    assert timings.rival_seconds(1).shape == (6,)
    assert width(timings, 2) <= 0.1 and marked(timings, 2)[0].value == 0


def test_more_rounds_for_a_chain_of_rivals():
    """A render that runs again because its metered twin is wide has its own rival beside it."""
    clock = Clock(noise=0.002, drift=0)
    noisy = np.random.default_rng(3)
    chain = [
        Contender("baseline", lambda _: clock.work(1)),
        Contender("bare", lambda _: clock.work(2), rival=0),
        Contender("metered", lambda _: 3 * math.exp(0.08 * noisy.normal()), rival=1),
    ]
    timings = interleave(chain, RoundSettings(rounds=6, max_rounds=400), quiet)
    taken = [len(timings.seconds(i)) for i in range(3)]
    assert taken[0] == taken[1] == taken[2] > 6
    assert ratio(timings, 1).value == pytest.approx(2, rel=0.01)


def test_a_disturbed_measurement_says_so():
    """How wide, and after how many rounds; all rounds are kept."""
    noisy = np.random.default_rng(0)
    pair = contenders(lambda _: 1.0, lambda _: math.exp(noisy.normal()))
    timings = interleave(pair, RoundSettings(rounds=6, max_rounds=9), quiet)
    record, reason = marked(timings, 1)
    assert record.value == 1 and len(timings.seconds(1)) == 9
    assert "c1" in reason and "after 9 rounds" in reason and "wider than 10%" in reason
    assert marked(timings, 0) == (type(record)("disturbed", 0.0, unit="1"), "")
    low, high = ratio(timings, 1)[1:]
    assert f"{(high - low) / ratio(timings, 1).value:.0%}" in reason


def test_by_default_twice_the_rounds():
    noisy = np.random.default_rng(0)
    one = contenders(lambda _: math.exp(noisy.normal()))
    assert len(interleave(one, RoundSettings(rounds=5), quiet).seconds(0)) == 10


def test_one_round_has_no_interval_and_is_marked():
    """Not being able to tell is not being undisturbed."""
    timings = interleave(contenders(lambda _: 1.0), RoundSettings(rounds=1, max_rounds=1), quiet)
    assert math.isnan(width(timings, 0)) and marked(timings, 0)[0].value == 1


def test_overhead_of_the_measuring(monkeypatch):
    """Time that passes between the timed calls, over the timed."""
    clock = Clock(noise=0, drift=0)
    monkeypatch.setattr(timing, "now", clock.now)

    def once(number: int) -> float:
        clock.work(0.25)  # the harness's own
        return clock.work(1.0)

    timings = interleave(contenders(once), RoundSettings(rounds=4, max_rounds=4), quiet)
    assert timings.wall / timings.timed - 1 == pytest.approx(0.25)


# --- warm-up ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "calls"),
    [([9, 3, 1, 1.05, 7], 4), ([1, 1, 7], 2), ([5, 1, 5, 1, 5, 1, 9], 6), ([50, 1, 1], 2)],
)
def test_warm_up_lasts_until_stable_or_for_its_time(times, calls):
    left = list(times)
    last = settle(lambda: left.pop(0), RoundSettings(warm_up=17, stable=0.1))
    assert len(times) - len(left) == calls and last == times[calls - 1]


def test_warm_up_counts_what_was_spent_before():
    left = [1.0, 5.0, 7.0]
    settle(lambda: left.pop(0), RoundSettings(warm_up=3), spent=2.5)
    # Never the first call alone: it may compile.
    assert left == [7.0]


# --- renders to a deadline -------------------------------------------------------------


def runner(clock: Clock, per_spp: float, deadline: float, overhead: float = 0.0) -> DeadlineRender:
    """Who knows its speed to 20 % only."""

    def render(spp: int, seed: int) -> Any:
        image = np.full((2, 2, 3), float(seed))
        return SimpleNamespace(seconds=clock.work(overhead + per_spp * spp), rgb=image)

    return DeadlineRender(render, 1.2 * per_spp, deadline, seed=0)


@pytest.mark.parametrize("seed", range(8))
def test_deadline_renders_end_together(seed):
    """Within 3 % of each other, at speeds from 1 to 300 samples a deadline's per cent."""
    clock = Clock(noise=0.05, drift=0.02, seed=seed)
    runners = [runner(clock, s, 1.0, overhead=1e-3) for s in (3e-5, 1e-4, 1e-3, 9e-3)]
    render_to_deadlines(runners)
    taken = [r.seconds for r in runners]
    assert max(taken) / min(taken) < 1.03
    for r in runners:
        assert r.miss == pytest.approx(r.seconds - 1) and abs(r.miss) < 0.015
        assert r.spp == sum(n for n, _ in r.chunks) and len(r.chunks) >= 9


def test_one_sample_that_takes_too_long():
    """There always is an image; how far off it is, is told."""
    clock = Clock(noise=0, drift=0)
    late, near = runner(clock, 2.5, 1.0), runner(clock, 0.3, 1.0)
    render_to_deadlines([late, near])
    assert late.spp == 1 and late.miss == pytest.approx(1.5)
    # Three samples are nearer to the deadline than four.
    assert near.spp == 3 and near.miss == pytest.approx(-0.1)


def test_a_slow_spell_hits_all():
    """Chunks alternate: nobody has it alone."""
    order: list[int] = []

    def render(index: int) -> Callable[[int, int], Any]:
        def one(spp: int, seed: int) -> Any:
            order.append(index)
            return SimpleNamespace(seconds=0.01 * spp, rgb=np.zeros((1, 1, 3)))

        return one

    render_to_deadlines([DeadlineRender(render(i), 0.01, 1.0, 0) for i in range(3)])
    assert all({*order[3 * k : 3 * k + 3]} == {0, 1, 2} for k in range(len(order) // 3))


def test_the_image_is_the_mean_of_its_samples():
    clock = Clock(noise=0, drift=0)
    one = runner(clock, 0.04, 1.0)
    render_to_deadlines([one])
    seeds = np.cumsum([0, *(n for n, _ in one.chunks)])[:-1]
    expected = sum(n * s for (n, _), s in zip(one.chunks, seeds, strict=True)) / one.spp
    np.testing.assert_allclose(one.image, expected)
    assert one.spp == 25
