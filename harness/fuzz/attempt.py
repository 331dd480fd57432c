"""What a kind of fuzzing is: files spoiled by a seed, and what has to come of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from random import Random

from harness.core.protocol.errors import InputError
from harness.core.text import unprintable

ACCEPTED, REFUSED = "accepted", "refused"


class Wrong(Exception):
    """An input that was neither accepted as it should be nor refused in one line."""


class Fuzz(ABC):
    """One kind of input. An object is made in the process that tries the inputs."""

    def __init__(self, folder: Path):
        self.folder = folder
        """For files; what an attempt leaves there is removed after it."""

    @abstractmethod
    def attempt(self, rng: Random) -> None:
        """Spoil an input and read it.

        Raises:
            InputError: it was refused.
            Wrong: it was taken for something that it is not.
        """


def outcome(fuzz: Fuzz, seed: int) -> tuple[str, str]:
    """``accepted`` or ``refused``, with the line that said so.

    Raises:
        Wrong: not one line, or one with something in it that cannot be printed.
        Exception: what a user would see as a traceback.
    """
    try:
        fuzz.attempt(Random(seed))
    except InputError as error:
        text = str(error)
        bad = [c for c in text if unprintable(c) and c != "\t"]
        if bad:
            raise Wrong(f"refused with {bad[0]!r} in: {text!r}") from None
        if len(text) > 2000:
            raise Wrong(f"refused in {len(text)} characters: {text[:200]!r}...") from None
        return REFUSED, text
    return ACCEPTED, ""
