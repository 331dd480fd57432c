"""Ways to spoil bytes and plain data at random; all are determined by the generator."""

from __future__ import annotations

import copy
import struct
from random import Random
from typing import Any

NUMBERS = (
    0, -1, 1, 2, 3, 7, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63,
    2**64, -(2**63), 10**11, 10**30, 0.0, -0.0, 0.5, 1e-300, 5e-324, 1e11, 1e300, -1e300,
    float("inf"), float("-inf"), float("nan"),
)  # fmt: skip
TEXTS = (
    "", " ", "\0", "a\0b", "\n", "a\nb", "\r", "\x1b[31mred", "\x1b]0;title\x07", "\x9b2J", "\x7f",
    "\u202eabc", "\u2028", "\ud800", "\udfff\ud800", "\ufeff", "\U0001f600", "é" * 60, "a" * 99,
    "a" * 101, "a" * 300, "a" * 5000, "a" * 30000, ".", "..", "../../../etc/passwd", "/dev/zero",
    "/dev/full", "/proc/self/x", "/", "~", "~nobody/x", "$HOME", "${x}", "%s%n", "=1+1", "+1",
    "@x", "-x", "|x", "`x`", "<b>", "</script>", "[x](y)", "\\input{x}", "nan", "inf",
    "1e-3", "null", "true", "table2.yaml", "scenes", "x.py:Y", "plan.py", ":", "a:b:c", "*", "[",
    "a/b", "a\\b",
    "CON", "fit", "quick", "fast", "knobs", "auto", "!!python/object:os.system",
)  # fmt: skip


def value(rng: Random) -> Any:
    """Something that is probably not expected."""
    kind = rng.randrange(8)
    if kind < 3:
        return rng.choice(NUMBERS)
    if kind < 6:
        return rng.choice(TEXTS)
    return rng.choice(
        (None, True, False, [], {}, [[]], [None], {"": ""}, {"name": None}, ["a"] * 1000,
         {str(i): i for i in range(1000)}, deep(rng.choice((10, 40, 200)), rng))
    )  # fmt: skip


def deep(depth: int, rng: Random) -> Any:
    """A list or mapping in itself, so many times."""
    found: Any = 1
    for _ in range(depth):
        found = [found] if rng.random() < 0.5 else {"a": found}
    return found


def spoiled(data: Any, rng: Random) -> Any:
    """Plain data with a few places changed, removed, doubled or moved."""
    data = copy.deepcopy(data)
    for _ in range(1 + rng.randrange(3)):
        places = list(_places(data))
        if not places:
            return value(rng)
        owner, key = rng.choice(places)
        other_owner, other = rng.choice(places)
        kind = rng.randrange(10)
        if kind < 5:
            owner[key] = value(rng)
        elif kind == 5:
            del owner[key]
        elif kind == 6 and isinstance(owner, dict):
            owner[str(rng.choice(TEXTS))] = owner.pop(key)
        elif kind == 7 and isinstance(owner, list):
            owner.append(copy.deepcopy(owner[key]))
        elif kind == 8:
            owner[key] = copy.deepcopy(other_owner[other])
        elif isinstance(owner[key], int | float) and not isinstance(owner[key], bool):
            owner[key] = owner[key] * rng.choice((-1, 0, 10, 1000, 10**9, 0.1))
        else:
            owner[key] = [owner[key]] if rng.random() < 0.5 else {"name": owner[key]}
    return data


def _places(data: Any) -> Any:
    """``(owner, key)`` of all that lies in lists and mappings."""
    todo = [data]
    while todo:
        owner = todo.pop()
        keys = list(owner) if isinstance(owner, dict) else range(len(owner))
        for key in keys:
            yield owner, key
            if isinstance(owner[key], dict | list):
                todo.append(owner[key])


def damaged(data: bytes, rng: Random) -> bytes:
    """Bytes with bits flipped, parts overwritten, cut, put in, doubled or exchanged."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        kind = rng.randrange(9)
        at = rng.randrange(len(out)) if out else 0
        # The head of a file is a small part of it and says the most.
        if rng.random() < 0.4:
            at = min(at, rng.randrange(256))
        size = rng.choice((1, 2, 4, 8, 64, 512, 4096))
        if kind == 0 and out:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at : at + size] = rng.randbytes(min(size, len(out) - at))
        elif kind == 2:
            out[at : at + size] = bytes(min(size, len(out) - at))
        elif kind == 3:
            del out[at:]
        elif kind == 4:
            del out[at : at + size]
        elif kind == 5:
            out[at:at] = rng.randbytes(size)
        elif kind == 6:
            other = rng.randrange(len(out)) if out else 0
            part = out[other : other + size]
            out[at : at + len(part)] = part
        elif kind == 7:
            number = int(rng.choice([n for n in NUMBERS if isinstance(n, int)]))
            width = rng.choice((2, 4, 8))
            out[at : at + width] = (number % (1 << 8 * width)).to_bytes(width, "little")
        else:
            out[at : at + 8] = struct.pack("<d", rng.choice(NUMBERS[-10:]))
    return bytes(out)
