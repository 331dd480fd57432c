"""A kind of fuzzing whose inputs go wrong in every way, by their seeds."""

from __future__ import annotations

import os
import time
from random import Random

from harness.core.protocol.errors import InputError
from harness.fuzz.attempt import Fuzz, Wrong

WAYS = ("accepted", "refused", "traceback", "taken for another", "hang", "end", "memory", "work")


class Planted(Fuzz):
    """The seed says the way."""

    def attempt(self, rng: Random) -> None:
        way = next(w for i, w in enumerate(WAYS) if Random(i).getstate() == rng.getstate())
        (self.folder / "left").mkdir()  # refused if an earlier attempt's is still there
        if way == "refused":
            raise InputError("as it should be")
        if way == "traceback":
            raise KeyError("planted")
        if way == "taken for another":
            raise Wrong("planted")
        if way == "hang":
            time.sleep(60)
        if way == "end":
            os._exit(0)
        if way == "memory":
            bytearray(3 * 2**30)
        if way == "work":
            while True:
                pass
