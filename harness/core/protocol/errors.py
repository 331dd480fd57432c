"""What the harness says when it refuses an input."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from harness.core.text import one_line, shortened


class InputError(ValueError):
    """A refused input: one line that says what, where and what was expected.

    The command line prints it without a traceback and exits with status 2. What the text holds of
    the input is made printable, and cut where it is long.
    """

    def __init__(self, text: str = ""):
        super().__init__(shortened(one_line(str(text))))


class Mistakes(InputError):
    """Several refused inputs of one file; ``lines`` are all of them, the message the first."""

    def __init__(self, lines: Iterable[str]):
        self.lines = list(dict.fromkeys(shortened(one_line(line)) for line in lines))
        more = len(self.lines) - 1
        said = f" (and {more} more, which 'harness validate' lists)" if more else ""
        super().__init__(f"{self.lines[0]}{said}")


class StateRefused(InputError):
    """A fitted state that a method cannot run correctly; ``number`` is the measure that says so."""

    def __init__(self, text: str, number: float):
        super().__init__(text)
        self.number = number


class Unsupported(Exception):
    """A method or measure that cannot be had for this material, scene or machine.

    Becomes a trial of status ``unsupported`` with this message as its reason.
    """


class BudgetExceeded(Exception):
    """A fit or measure ran past its time limit; becomes a trial of status ``timeout``."""


def nearest(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` for the closest known name, or the list of all of them."""
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if close:
        return f"; did you mean '{close[0]}'?"
    return f"; known: {', '.join(known)}" if known else ""
