"""Shows what is going on: a live line on a terminal, a line per trial anywhere else."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from statistics import mean

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bar
from rich.text import Text

from harness.measures.base import FAILED, Outcome
from harness.store.stored import Stored
from harness.suite.trials import FIT, Trial

QUIET_SECONDS = 15.0
"""Without a terminal, notes from inside a trial appear at most this often."""


_FEW = 4
"""Trials after which the time beside them tells something."""


class Pace:
    """Time left, from what trials of the same measure took, in this run or an earlier one.

    Of the same method if there were any, for methods differ by a hundred times; else what it took
    ``elsewhere`` (:mod:`harness.runner.known_seconds`), by how much faster or slower this run is.
    A method that nothing is known of is taken to be like the others in the measure, a measure that
    was not seen yet as nothing: then it is said to be more. ``slots`` trials that are not timed run
    side by side. What a run takes beside its trials (workers that start, probes) is taken
    to go on as it did so far.
    """

    def __init__(
        self,
        todo: list[Trial],
        stored: dict[str, Stored],
        slots: int = 1,
        clock: Callable[[], float] = time.monotonic,
        elsewhere: Mapping[tuple[str, str], float] | None = None,
    ):
        self.elsewhere = elsewhere or {}
        self.slots, self.clock, self.began = slots, clock, clock()
        self.timed = {t.measure for t in todo if t.timed}
        self.worked: list[float] = []
        """Of each trial of this run: the seconds by which it would make the run longer alone."""
        self.left: Counter[tuple[str, str]] = Counter((t.measure, t.method) for t in todo)
        self.spent: dict[tuple[str, str], list[float]] = {}
        for found in stored.values():
            # What came with the harness took its time elsewhere.
            if found.status == "ok" and not found.shipped:
                key = (found.labels["measure"], found.labels["method"])
                self.spent.setdefault(key, []).append(found.seconds)

    def finish(self, trial: Trial, seconds: float) -> None:
        """One trial less."""
        key = (trial.measure, trial.method)
        # The baseline may run along without being counted.
        self.left[key] = max(0, self.left[key] - 1)
        if seconds:
            self.spent.setdefault(key, []).append(seconds)
            self.worked.append(self._share(key) * seconds)

    def seconds(self) -> float:
        """Seconds that are left, as far as measures were seen; 0 if none was."""
        known = self._known()
        return self._beside() * sum(self._share(key) * value for key, value in known.items())

    def __str__(self) -> str:
        seconds = self.seconds()
        if not seconds:
            return ""
        left = (key for key, count in self.left.items() if count)
        whole = all(key in self.spent or key in self.elsewhere for key in left)
        return f"{'about' if whole else 'more than'} {duration(seconds)} left"

    def _known(self) -> dict[tuple[str, str], float]:
        """Seconds of all that is left of a method in a measure, where they can be known."""
        left = {key: count for key, count in self.left.items() if count}
        return {key: count * usual for key, count in left.items() if (usual := self._usual(key))}

    def _share(self, key: tuple[str, str]) -> float:
        return 1.0 if key[0] in self.timed else 1 / self.slots

    def _beside(self) -> float:
        """The seconds of the run so far over those of its trials; 1 before it tells anything."""
        worked = sum(self.worked)
        if len(self.worked) < _FEW or worked <= 0:
            return 1.0
        # Work is in the time that it took: less than all of it can only be a coarse clock's.
        return max(1.0, (self.clock() - self.began) / worked)

    def _usual(self, key: tuple[str, str]) -> float:
        """Mean seconds of the method in the measure, or of all methods in it; 0 if none was."""
        if key not in self.spent and key in self.elsewhere:
            return self.elsewhere[key] * self._speed()
        own = self.spent.get(key, [])
        spent = own or [s for (m, _), every in self.spent.items() if m == key[0] for s in every]
        return mean(spent) if spent else 0.0

    def _speed(self) -> float:
        """Seconds of trials here over those elsewhere, of all that is known of both; else 1."""
        both = [key for key in self.spent if key in self.elsewhere]
        there = sum(self.elsewhere[key] for key in both)
        return sum(mean(self.spent[key]) for key in both) / there if there else 1.0


class Progress:
    """Progress of a run on ``console``; use it as a context manager."""

    def __init__(
        self,
        console: Console,
        todo: list[Trial],
        stored: dict[str, Stored],
        slots: int = 1,
        elsewhere: Mapping[tuple[str, str], float] | None = None,
        ready: Collection[str] = (),
    ):
        """``ready``: keys of the fits that are not run, since they come with the harness."""
        self.console, self.total, self.done = console, len(todo), 0
        self.ready = ready
        self.running: set[str] = set()
        self.failed = 0
        work = [trial for trial in todo if trial.hash not in ready]
        self.pace = Pace(work, stored, slots, elsewhere=elsewhere)
        self.quiet_since = time.monotonic()
        self.text = ""
        self.bar: Bar | None = None
        if console.is_terminal:
            columns = (
                SpinnerColumn(),
                BarColumn(bar_width=24),
                MofNCompleteColumn(),
                TextColumn("{task.fields[left]}", style="cyan"),
                TextColumn("{task.description}", markup=False),
            )
            self.bar = Bar(*columns, console=console, transient=True)
            self.task = self.bar.add_task("", total=self.total, left=self._state())

    def __enter__(self) -> Progress:
        if self.bar:
            self.bar.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self.bar:
            self.bar.stop()

    def begin(self, trials: list[Trial]) -> None:
        """These are being carried out now."""
        self.running |= {trial.hash for trial in trials}
        what = "fitting" if trials[0].measure == FIT else trials[0].measure
        who = trials[0].method if len(trials) == 1 else f"{len(trials)} methods"
        self.text = " · ".join(filter(None, [what, who, trials[0].material, trials[0].scene]))
        self.quiet_since = time.monotonic()
        self._show(self.text)

    def note(self, text: str) -> None:
        """Something to say from inside a trial."""
        if self.bar:
            self._show(f"{self.text} · {text}")
        elif time.monotonic() - self.quiet_since > QUIET_SECONDS:
            self.quiet_since = time.monotonic()
            self._line(f"          {self.text} · {text}")

    def finish(self, trial: Trial, outcome: Outcome, seconds: float) -> None:
        """One trial is stored."""
        self.done = min(self.total, self.done + 1)
        if trial.hash not in self.ready:
            self.pace.finish(trial, seconds)
        failed = outcome.status in FAILED
        self.failed += failed
        self.running.discard(trial.hash)
        if self.bar:
            self.bar.update(self.task, completed=self.done, left=self._state())
            if failed:
                self._line(f"{outcome.status}: {trial}: {outcome.reason}", "red")
            return
        width = len(str(self.total))
        parts = [str(trial), outcome.status, f"{seconds:.1f} s", self._state()]
        if outcome.status != "ok":
            parts[1] += f": {outcome.reason}"
        self._line(f"[{self.done:{width}}/{self.total}] " + " · ".join(filter(None, parts)))

    def _state(self) -> str:
        """``3 failed · 2 running · about 5 min left``; what is none, or plain, is left out."""
        parts = [f"{self.failed} failed" if self.failed else ""]
        parts += [f"{len(self.running)} running" if len(self.running) > 1 else ""]
        return " · ".join(filter(None, [*parts, str(self.pace)]))

    def _show(self, text: str) -> None:
        if self.bar:
            self.bar.update(self.task, description=text)

    def _line(self, text: str, style: str = "") -> None:
        self.console.print(Text(text, style=style), soft_wrap=True)
        self.console.file.flush()


def duration(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3 h 20 min``."""
    if seconds < 90:
        return f"{whole(seconds)} s"
    minutes = whole(seconds / 60)
    if minutes < 90:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"


def whole(value: float) -> int:
    """Upwards, and at least one: nothing that is left takes no time."""
    return max(1, int(-(-value // 1)))
