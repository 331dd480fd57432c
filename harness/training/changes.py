"""Changes of a training's profile from the command line: ``--set KEY=VALUE``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

from harness.core.protocol.errors import InputError

Profile = TypeVar("Profile")


def changed(profile: Profile, changes: Sequence[str]) -> Profile:
    """The profile with values of its own or sizes of its ``architecture`` replaced.

    Its own are numbers and texts; what is none of them is a size of the network.

    Raises:
        InputError: no ``KEY=VALUE``, or a value of another type, negative or not finite.
    """
    sizes, own = profile.architecture.as_dict(), {}
    known = {k: v for k, v in vars(profile).items() if isinstance(v, int | float | str)}
    for change in changes:
        key, equals, text = change.partition("=")
        if not equals:
            raise InputError(f"--set {change}: expected KEY=VALUE")
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            value = text
        if key in known:
            own[key] = _value(change, type(known[key]), value)
        else:
            sizes[key] = value
    architecture = type(profile.architecture).of(sizes, "--set")
    return replace(profile, architecture=architecture, **own)


def _value(change: str, kind: type, value: Any) -> Any:
    right = isinstance(value, kind) or (kind is float and isinstance(value, int))
    if not right or isinstance(value, bool):
        least = "" if kind is str else " of at least 0"
        raise InputError(f"--set {change}: expected {kind.__name__}{least}")
    if kind is not str and not 0 <= value < math.inf:
        raise InputError(f"--set {change}: expected {kind.__name__} of at least 0")
    return kind(value)
