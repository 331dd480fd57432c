"""Shows what is going on: a live line on a terminal, a line per trial anywhere else."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

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

    Of the same method if there were any, for methods differ by a hundred times. For a measure that
    was not seen yet nothing is made up: then it is said to be more. ``slots`` trials that are not
    timed run side by side. What a run takes beside its trials (workers that start, probes) is taken
    to go on as it did so far.
    """

    def __init__(
        self,
        todo: list[Trial],
        stored: dict[str, Stored],
        slots: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ):
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
        whole = len(self._known()) == sum(count > 0 for count in self.left.values())
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
        own = self.spent.get(key, [])
        spent = own or [s for (m, _), every in self.spent.items() if m == key[0] for s in every]
        return sum(spent) / len(spent) if spent else 0.0


class Progress:
    """Progress of a run on ``console``; use it as a context manager."""

    def __init__(
        self, console: Console, todo: list[Trial], stored: dict[str, Stored], slots: int = 1
    ):
        self.console, self.total, self.done = console, len(todo), 0
        self.running: set[str] = set()
        self.failed = 0
        self.pace = Pace(todo, stored, slots)
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
