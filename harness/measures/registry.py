"""Finds measures by name; a measure's file is imported when it is asked for."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from harness.core.classes import named
from harness.core.protocol.errors import InputError, nearest
from harness.measures import bounds
from harness.measures.base import Measure

MEASURES = Path(__file__).parent
_EXTRA: dict[str, type[Measure]] = {}


def register(measure: type[Measure]) -> None:
    """Make a measure that has no file in this folder known to this process."""
    _EXTRA[measure.name] = measure


def names() -> list[str]:
    """Names of all measures, sorted; nothing is imported."""
    return sorted({*named(MEASURES), *_EXTRA})


def describe(name: str) -> str:
    """One line about the measure, from its docstring."""
    found = named(MEASURES)
    if name in found:
        return found[name].summary
    return (load(name).__doc__ or "").strip().partition("\n")[0]


def load(name: str) -> type[Measure]:
    """The class of the measure called ``name``."""
    if name in _EXTRA:
        return _EXTRA[name]
    found = named(MEASURES)
    if name not in found:
        raise InputError(f"unknown measure '{name}'{nearest(name, names())}")
    module = import_module(f"harness.measures.{found[name].file.stem}")
    return getattr(module, found[name].class_name)


def make(name: str) -> Measure:
    """A new measure."""
    return load(name)()


def settings(name: str, given: dict[str, Any]) -> dict[str, Any]:
    """All settings of a measure: those ``given``, checked, and the defaults of the rest."""
    model = load(name).Settings
    try:
        # Through JSON, in which a list is a valid tuple even where types are strict.
        found = model.model_validate_json(json.dumps(given)).model_dump(mode="json")
        bounds.check(name, found)
        return found
    except TypeError as error:
        raise InputError(f"measure '{name}': {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        if first["type"] == "extra_forbidden":
            hint = nearest(key, model.model_fields) or "; it has none"
            raise InputError(f"unknown setting '{key}' of measure '{name}'{hint}") from None
        what = first["msg"].replace("Input should be", "expected")
        raise InputError(f"{key}: {what}, got {first['input']!r} (measure '{name}')") from None
