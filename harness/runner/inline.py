"""Tasks carried out in the process of the run: for debuggers, and for nothing else.

A hang hangs the run, a crash ends it, and what a method changes stays changed for those after it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

from harness.runner.carry_out import Carrier
from harness.runner.task import Answer, Task
from harness.suite.resolve import Resolved


class Inline:
    """See :class:`harness.runner.executor.Executor`."""

    slots, timed_slots, isolated = 1, 1, False

    def __init__(self, note: Callable[[str], None], resolved: Resolved):
        self.carrier = Carrier(note, resolved)
        self.answers: list[tuple[int, Answer]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.carrier.jobs.forget_methods()

    def submit(self, number: int, task: Task) -> None:
        """Carry it out."""
        self.answers.append((number, self.carrier.do(task)))

    def wait(self) -> list[tuple[int, Answer]]:
        """See :class:`harness.runner.executor.Executor`."""
        answers, self.answers = self.answers, []
        return answers
