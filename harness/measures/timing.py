"""Timing that can be trusted: warm-up, and interleaved rounds until intervals are narrow."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from harness.measures.base import Settings
from harness.stats.intervals import Interval
from harness.stats.round_times import RoundTimes


class RoundSettings(Settings):
    """``rounds`` are run in any case; up to ``max_rounds`` (default: twice as many) while an
    interval is wider than ``tolerance``, its full width over its value. A warm-up ends when
    two calls in a row agree within ``stable``, or after ``warm_up`` seconds.
    """

    rounds: int = 12
    max_rounds: int | None = None
    tolerance: float = 0.1
    stable: float = 0.1
    warm_up: float = 3.0


@dataclass(frozen=True)
class Contender:
    """One thing to be timed.

    ``once(round)`` does the work with its result forced and returns the seconds that took;
    ``units`` is how much work that is. ``rival`` is the index of the contender whose time in
    the same round this one's is divided by, None for one that is compared with nothing.

    With ``slices`` it is timed in so many slices a round, a call of ``once`` each, every slice
    beside one of the rival's, which of the two goes first alternating: a machine that slows down
    for a tenth of a second then slows both. Without, the rival's own time in the round is what this
    one is compared with.
    """

    label: str
    once: Callable[[int], float]
    units: float = 1.0
    rival: int | None = None
    slices: int = 0

    @property
    def needed(self) -> int | None:
        """Whom a round of this one needs: its rival, unless that is timed in slices beside it."""
        return None if self.slices else self.rival


@dataclass
class Timings:
    """All times of interleaved rounds: nothing is dropped, and no best is picked."""

    contenders: Sequence[Contender]
    tolerance: float
    loadavg: NDArray = field(default_factory=lambda: np.array(os.getloadavg()))
    """The system's load averages over 1, 5 and 15 minutes when the rounds began."""
    wall: float = 0.0
    """Seconds from the first round to the last, the harness's own work included."""
    _taken: list[dict[int, float]] = field(default_factory=list)
    _beside: list[dict[int, float]] = field(default_factory=list)
    _timed: float = 0.0

    def __post_init__(self) -> None:
        self._taken = [{} for _ in self.contenders]
        self._beside = [{} for _ in self.contenders]

    def take(self, index: int, number: int) -> None:
        """Time contender ``index`` in round ``number``."""
        one = self.contenders[index]
        if one.slices and one.rival is not None:
            rival = self.contenders[one.rival]
            pairs = [self._pair(rival, one, number, k % 2 == 1) for k in range(one.slices)]
            theirs, own = (float(np.mean(seconds)) for seconds in zip(*pairs, strict=True))
            self._beside[index][number] = theirs
        else:
            own = float(np.mean([self._once(one, number) for _ in range(max(1, one.slices))]))
        self._taken[index][number] = own

    def _pair(
        self, rival: Contender, one: Contender, number: int, swapped: bool
    ) -> tuple[float, float]:
        """Seconds of a slice of each; ``swapped``, ``one`` goes first."""
        if swapped:
            own = self._once(one, number)
            return self._once(rival, number), own
        return self._once(rival, number), self._once(one, number)

    def _once(self, one: Contender, number: int) -> float:
        seconds = one.once(number)
        self._timed += seconds
        return seconds

    def seconds(self, index: int) -> NDArray:
        """Seconds per unit [rounds], in the order of the rounds."""
        taken = self._taken[index]
        return np.array([taken[k] for k in sorted(taken)]) / self.contenders[index].units

    def rival_seconds(self, index: int) -> NDArray:
        """Seconds per unit of the rival in the same rounds; its own for one without a rival."""
        rival = self.contenders[index].rival
        other = index if rival is None else rival
        taken, units = self._beside[index] or self._taken[other], self.contenders[other].units
        return np.array([taken[k] for k in sorted(self._taken[index])]) / units

    def of(self, index: int) -> RoundTimes:
        """Its times beside its rival's, with their intervals."""
        one = self.contenders[index]
        rival = None if one.rival is None else self.rival_seconds(index)
        return RoundTimes(one.label, self.seconds(index), rival)

    def median(self, index: int) -> Interval:
        """Of seconds per unit."""
        return self.of(index).median()

    def wide(self) -> list[int]:
        """Those whose interval is wider than ``tolerance``, or that have none."""
        return [i for i in range(len(self.contenders)) if self.of(i).wide(self.tolerance)]

    @property
    def timed(self) -> float:
        """Seconds spent in what was timed, of all contenders together."""
        return self._timed


def interleave(
    contenders: Sequence[Contender], settings: RoundSettings, notify: Callable[[str], None]
) -> Timings:
    """Time all ``contenders`` in rounds of ever another order, so that drift hits all alike, and
    nobody always comes after the one that leaves the caches and the memory worst.

    After the planned rounds those whose interval is still too wide go on, each with its rival
    in the same round, until it is narrow enough or the budget of rounds is spent. All
    rounds count; stopping when an interval is narrow makes its coverage a little less than 95 %,
    more rounds than a fixed number make it narrower.
    """
    most = 2 * settings.rounds if settings.max_rounds is None else settings.max_rounds
    timings = Timings(contenders, settings.tolerance)
    everybody = list(range(len(contenders)))
    start = now()
    for number in range(max(settings.rounds, most)):
        if number < settings.rounds:
            running, of = everybody, settings.rounds
        else:
            wide = timings.wide()
            if not wide:
                break
            running, of = sorted(_with_rivals(contenders, wide)), most
        notify(f"timing round {number + 1} of {of}, {len(running)} contenders")
        for place in round_order(len(running), number):
            timings.take(running[place], number)
    timings.wall = now() - start
    return timings


def round_order(count: int, number: int) -> NDArray:
    """Who comes when in round ``number``: a permutation [count] drawn for the round, so that nobody
    always follows the same one; its first rotates."""
    drawn = np.random.default_rng(number).permutation(count)
    return np.roll(drawn, -int(np.flatnonzero(drawn == number % count)[0]))


def _with_rivals(contenders: Sequence[Contender], wanted: Iterable[int]) -> set[int]:
    """``wanted``, those whose times they are compared with, and those that these need."""
    found: set[int] = set()
    for index in wanted:
        step: int | None = index
        while step is not None and step not in found:
            found.add(step)
            step = contenders[step].needed
    return found


def settle(
    once: Callable[[], float], settings: RoundSettings, tries: int = 20, spent: float = 0.0
) -> float:
    """Repeat ``once`` until its time is stable; the last time in seconds.

    ``spent`` seconds of the warm-up are already gone. Two calls there always are: the first
    may compile.
    """
    last = np.inf
    for _ in range(tries):
        seconds = once()
        spent += seconds
        steady = abs(seconds - last) < settings.stable * last
        if np.isfinite(last) and (steady or spent > settings.warm_up):
            return seconds
        last = seconds
    return last


def now(device: str = "cpu") -> float:
    """Seconds on a steady clock, after everything that was queued on ``device`` is done."""
    if device != "cpu":
        torch.cuda.synchronize(device)
    return time.perf_counter()


def seconds_of(call: Callable[[], object], device: str) -> float:
    """Seconds of ``call`` and of what it queued on ``device``, without gradients."""
    start = now(device)
    with torch.inference_mode():
        call()
    return now(device) - start
