"""Between what bounds a measure's settings lie, by what they are called.

What a measure itself refuses (fewer batches than give an interval) stands in its ``Settings``;
these are the bounds of sense and of machines, the same for all measures.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from harness.core.protocol.errors import InputError
from harness.core.sizes import COUNT, SECONDS, SIDE

_MANY = 10**6
"""Rounds, batches, processes: of each a table keeps a number."""

BOUNDS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(
        ("batch", "conditions", "pixels", "points", "rows", "samples", "spp"), (1, COUNT)
    ),
    **dict.fromkeys(("reference_spp", "steps"), (1, COUNT)),
    **dict.fromkeys(
        ("grid", "picture_size", "resolution", "side", "size", "slice_resolution"), (1, SIDE)
    ),
    **dict.fromkeys(("batches", "bins", "count", "longest", "repeats", "rounds"), (1, _MANY)),
    **dict.fromkeys(("processes", "slices", "views"), (1, _MANY)),
    # None of them is a number of its own, too: no more than there are, nothing shown or started.
    **dict.fromkeys(("max_processes", "max_rounds", "shown", "starts"), (0, _MANY)),
    "levels": (1, 64),  # each doubles the one before
    **dict.fromkeys(("deadline", "slice_seconds"), (1e-9, SECONDS)),
    **dict.fromkeys(("least_seconds", "max_seconds", "patience", "power_seconds"), (0, SECONDS)),
    **dict.fromkeys(("reference_seconds", "warm_up"), (0, SECONDS)),
    **dict.fromkeys(("agreement", "detect", "stable", "tolerance"), (0, _MANY)),
    "resolutions": (1, SIDE),
}
"""``(least, most)``; a measure of one's own may have settings that are not here."""


def check(measure: str, settings: Mapping[str, Any]) -> None:
    """Refuse settings that no machine can carry out, or that make no sense.

    Raises:
        InputError: one is out of its bounds.
    """
    for key, value in settings.items():
        if key not in BOUNDS:
            continue
        low, high = BOUNDS[key]
        for number in value if isinstance(value, list) else [value]:
            if number is not None and not low <= number <= high:
                raise InputError(
                    f"{key}: expected a number from {low:g} to {high:g}, got {number!r}"
                    f" (measure '{measure}')"
                )
