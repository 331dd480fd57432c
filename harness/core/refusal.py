"""Turns a validation error into one line: key path, what was expected, the nearest name."""

from __future__ import annotations

from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from harness.core.protocol.errors import nearest


def refusal(model: type[BaseModel], error: ValidationError) -> str:
    """The first complaint of ``error`` about data for ``model``, in one line."""
    return refusals(model, error)[0]


def refusals(model: type[BaseModel], error: ValidationError) -> list[str]:
    """All complaints of ``error`` about data for ``model``, a line each."""
    return [_line(model, complaint) for complaint in error.errors()]


def _line(model: type[BaseModel], first: Any) -> str:
    where = first["loc"]
    if first["type"] == "extra_forbidden":
        known = list(_model_at(model, where[:-1]).model_fields)
        return f"{_prefix(where[:-1])}unknown key '{where[-1]}'{nearest(str(where[-1]), known)}"
    if first["type"] == "missing":
        return f"{_prefix(where[:-1])}missing key '{where[-1]}'"
    if first["type"] == "model_type":
        expected = "expected a mapping"
    elif first["type"] == "string_pattern_mismatch":
        expected = "expected a name of letters, digits, '_', '.' and '-'"
    else:
        expected = (
            first["msg"]
            .replace("Input should be", "expected")
            .replace("List should have", "expected")
        )
    got = repr(first["input"])
    return f"{_prefix(where)}{expected}, got {got if len(got) < 60 else got[:57] + '...'}"


def keypath(where: tuple[Any, ...]) -> str:
    """``('methods', 2, 'label')`` as ``methods[2].label``."""
    text = ""
    for part in where:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _prefix(where: tuple[Any, ...]) -> str:
    return f"{keypath(where)}: " if where else ""


def _model_at(model: Any, where: tuple[Any, ...]) -> type[BaseModel]:
    """The model that describes the data at ``where``."""
    for part in where:
        if isinstance(model, type) and issubclass(model, BaseModel):
            model = model.model_fields[str(part)].annotation
        else:
            model = get_args(model)[-1]
        while get_origin(model) not in (None, list, dict):
            model = get_args(model)[0]  # Optional[X] and Annotated[X, ...]
    return model
