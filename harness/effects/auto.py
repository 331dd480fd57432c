"""``effects: auto``: the smallest set whose image is that of all effects, within a tolerance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from harness.core.protocol.errors import InputError

AUTO = "auto"
TOLERANCE = 0.01
"""Largest root of the relative mean squared error that leaving effects out may cost."""


def read_auto(effects: Any, where: str) -> float | None:
    """The tolerance of ``auto`` or ``{auto: TOLERANCE}``; None for anything else.

    Raises:
        InputError: a tolerance that is none.
    """
    if effects in (AUTO, [AUTO], (AUTO,)):
        return TOLERANCE
    if isinstance(effects, list | tuple) and len(effects) == 1:
        only = effects[0]
        text = isinstance(only, str) and only.partition(":")[0] == AUTO
        effects = {AUTO: _number(only)} if text else only
    if not (isinstance(effects, Mapping) and AUTO in effects):
        return None
    value = effects[AUTO]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if len(effects) > 1 or not (number and math.isfinite(value) and 0 < value < 1):
        raise InputError(
            f"{where}: effects: expected auto, or a tolerance between 0 and 1 as {{auto: 0.01}},"
            f" got {dict(effects)!r}"
        )
    return float(value)


def _number(text: str) -> float | str:
    value = text.partition(":")[2].strip()
    try:
        return float(value)
    except ValueError:
        return value
