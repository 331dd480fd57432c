"""Whether what was stored has the form of it: a store may be another's, with checksums that fit.

What a field holds is told from its type in :class:`~harness.store.stored.Stored`. What lies deeper,
such as the settings of a measure, is for those who read it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from operator import itemgetter
from typing import Any

from harness.store.stored import LABELS, Stored

_STATUSES = ("ok", "skipped", "unsupported", "timeout", "error", "nonfinite")
_NUMBERS = ("nan", "inf", "-inf")


def checked_body(data: Any) -> dict[str, Any]:
    """The body of a trial, parsed, if it is one.

    Raises:
        ValueError: it has not the form; says which field.
    """
    if not isinstance(data, dict):
        raise ValueError("it is no mapping")
    for key, value in data.items():
        fine = _BODY.get(key)
        if fine is None:
            raise ValueError(f"it has a field that is not known: {key}")
        if not fine(value):
            raise ValueError(f"its {key} is not in the form of one")
    for key in ("trial_key", "status", "arrays", "files"):
        if key not in data:
            raise ValueError(f"it has no {key}")
    # What is empty is left out when a trial is stored.
    return {"trial": {}, "labels": {}, **data}


def checked_plan(data: Any) -> dict[str, Any]:
    """A plan, parsed, if it is one; the identities in it are still digests.

    Raises:
        ValueError: it has not the form of one.
    """
    if not (isinstance(data, dict) and isinstance(data.get("trials"), list)):
        raise ValueError("it has no list of trials")
    for row in data["trials"]:
        if not (isinstance(row, dict) and isinstance(row.get("trial"), str)):
            raise ValueError("one of its trials has no key")
        if not (_labels(row) and is_texts(row.get("identity")) and _text(row.get("fit"))):
            raise ValueError(f"its trial {row['trial']} is not in the form of one")
    for key in ("suite", "title", "profile", "device", "baseline"):
        if not (data.get(key) is None or isinstance(data[key], str)):
            raise ValueError(f"its {key} is no text")
    report = data.get("report")
    if not (report is None or isinstance(report, dict)) or any(
        not (names is None or isinstance(names, list)) for names in (report or {}).values()
    ):
        raise ValueError("its report is no lists of names")
    return data


# Of JSON, types are exact: no subclass has to be thought of, and ten thousand trials are looked at.


def _text(value: Any) -> bool:
    return type(value) is str


def _number(value: Any) -> bool:
    return type(value) is float or type(value) is int


def _mapping(value: Any) -> bool:
    return type(value) is dict


def is_texts(value: Any) -> bool:
    """Whether it is a mapping of texts; ``value`` is parsed JSON."""
    return type(value) is dict and {*map(type, value.values())} <= _ONLY_TEXT


_ONLY_TEXT = {str}
_named = itemgetter(*(key for key in LABELS if key != "seed"))


def _labels(value: Any) -> bool:
    """A seed, and texts."""
    try:
        return {*map(type, _named(value))} == _ONLY_TEXT and _number(value["seed"])
    except (KeyError, TypeError):  # one is not there, or it is no mapping
        return False


def _value(value: Any) -> bool:
    return type(value) is float or type(value) is int or value in _NUMBERS


def _record(record: Any) -> bool:
    return type(record) is dict and (
        type(record.get("metric")) is str
        and type(record.get("unit")) is str
        and _value(record.get("value"))
        and _value(record.get("ci_low"))
        and _value(record.get("ci_high"))
    )


def _records(value: Any) -> bool:
    return type(value) is list and all(map(_record, value))


_FORMS: dict[str, Callable[[Any], bool]] = {
    "str": _text,
    "float": _number,
    "dict[str, str]": is_texts,
    "dict[str, Any]": _mapping,
}
_BODY: dict[str, Callable[[Any], bool]] = {
    **{
        field.name: _FORMS.get(str(field.type), lambda value: True)
        for field in fields(Stored)
        if field.name not in ("hash", "folder", "reader", "kept_arrays")
    },
    # Kept once for all trials that share them, and named by digests.
    **dict.fromkeys(("trial", "environment", "documents", "entries", "arrays"), is_texts),
    "trial_key": _text,
    "labels": lambda value: _mapping(value) and (not value or _labels(value)),
    "status": lambda value: value in _STATUSES,
    "records": _records,
}
"""By field of a body: whether a value may stand there."""
