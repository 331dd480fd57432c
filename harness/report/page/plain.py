"""Numbers and texts as JSON that a page can hold."""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from harness.analysis.combine import Estimate

_ESCAPED = re.compile("[<>&\u2028\u2029\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Ends of elements and lines, control characters, and what turns the direction of text."""
DIGITS = 6
"""Significant digits of a number on the page; what is printed comes as text."""


def number(value: float | None, digits: int = DIGITS) -> float | str | None:
    """A number of few digits: None for nan, "Infinity" as text, which JSON lacks."""
    if value is None or math.isnan(value):
        return None
    if math.isinf(value):
        return "Infinity" if value > 0 else "-Infinity"
    short = float(f"{float(value):.{digits}g}")
    return int(short) if short.is_integer() and abs(short) < 1e15 else short


def series(values: Iterable[float], digits: int = DIGITS) -> list[float | str | None]:
    """Numbers one after another."""
    return [number(float(value), digits) for value in values]


def estimate(found: Estimate | str) -> dict[str, Any]:
    """``{v, l, h, note}``, or ``{why}`` where there is no number."""
    if isinstance(found, str):
        return {"why": found}
    made = {"v": number(found.value), "l": number(found.low), "h": number(found.high)}
    return made | ({"note": found.note} if found.note else {})


def packed(array: np.ndarray) -> dict[str, Any]:
    """An array of 8 or 16 bits a value, as text.

    Values of a row follow as differences to the one before, of several planes [..., H, W] each
    by itself; high and low bytes apart, deflated, base64.
    """
    import zlib

    data = np.ascontiguousarray(array)
    bits = 8 * data.dtype.itemsize
    whole = data.view(np.uint8 if bits == 8 else np.uint16)
    before = np.zeros_like(whole)
    before[..., 1:] = whole[..., :-1]
    step = (whole - before).ravel()
    if bits == 16:
        step = np.concatenate([(step >> 8).astype(np.uint8), (step & 255).astype(np.uint8)])
    text = base64.b64encode(zlib.compress(step.tobytes(), 6)).decode("ascii")
    return {"shape": list(data.shape), "bits": bits, "data": text}


def script_json(data: Any) -> str:
    """JSON for a ``script`` element: no ``<`` that could end it or begin a comment."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    text = _ESCAPED.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
    # Half of a surrogate pair has no UTF-8, and NUL no place in HTML.
    return text.encode("utf-8", "replace").decode("utf-8")
