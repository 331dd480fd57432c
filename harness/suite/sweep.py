"""``sweep`` of a suite's method: the method itself, and one at a time from it other settings.

A method ``{name: neural-spline-flow, sweep: {bins: [5, 20]}}`` stands for itself and, for every
value that it does not have anyway, for ``{name: neural-spline-flow, params: {bins: 5}}``, called
"neural-spline-flow bins=5". A knob is a parameter of the constructor, or an entry of the fitting
budget as ``budget.steps``. Several knobs are not multiplied: each is moved alone. ``sweep:
knobs`` takes all that the adapter declares (``Method.knobs``).
"""

from __future__ import annotations

import inspect
from typing import Any

from pydantic import ValidationError

from harness.core import registry
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.method import Method
from harness.core.refusal import refusal
from harness.suite.schema import BudgetSpec, MethodSpec

BUDGET = "budget."
_MISSING = object()


def expand(methods: list[MethodSpec]) -> list[MethodSpec]:
    """``methods`` with every sweep written out; labelled ones in, labelled ones out.

    Raises:
        InputError: a knob that the method does not have, or a value twice.
    """
    found = []
    for index, spec in enumerate(methods):
        found.append(spec)
        if spec.sweep is None:
            continue
        try:
            found += _variants(spec)
        except InputError as error:
            raise InputError(f"methods[{index}].sweep: {error}") from None
    return found


def _variants(spec: MethodSpec) -> list[MethodSpec]:
    """All other settings that the sweep of ``spec`` names, knob by knob, in its order."""
    loaded = registry.load(spec.name)
    variants = []
    for knob, values in _swept(spec, loaded).items():
        own = _own_value(spec, loaded, knob)
        for index, value in enumerate(values):
            if value in values[:index]:
                raise InputError(f"{knob}: {value!r} is listed twice")
            if value != own:
                variants.append(_variant(spec, knob, value))
    return variants


def _swept(spec: MethodSpec, loaded: type[Method]) -> dict[str, list[Any]]:
    """Values by knob, as written or as declared."""
    if spec.sweep == "knobs":
        if not loaded.knobs:
            raise InputError(f"{spec.name} declares no knobs")
        return {knob.name: list(knob.values) for knob in loaded.knobs}
    if not isinstance(spec.sweep, dict) or not spec.sweep:
        raise InputError(
            "expected 'knobs', or lists of values by knob as {width: [16, 32]},"
            f" got {spec.sweep!r}"
        )
    for knob, values in spec.sweep.items():
        if not isinstance(knob, str):
            raise InputError(f"expected the name of a knob, got {knob!r}")
        if not isinstance(values, list) or not values:
            raise InputError(f"{knob}: expected a list of values, got {values!r}")
    return spec.sweep


def _own_value(spec: MethodSpec, loaded: type[Method], knob: str) -> Any:
    """What ``spec`` has for ``knob`` as written; a budget left to the suite has no value here."""
    if knob.startswith(BUDGET):
        key = knob.removeprefix(BUDGET)
        if key not in BudgetSpec.model_fields:
            raise InputError(f"unknown knob '{knob}'{nearest(knob, _known(loaded))}")
        return getattr(spec.budget, key)
    parameters = inspect.signature(loaded).parameters
    free = any(item.kind is inspect.Parameter.VAR_KEYWORD for item in parameters.values())
    if knob not in parameters and not free:
        hint = nearest(knob, _known(loaded))
        raise InputError(f"unknown knob '{knob}' of {spec.name}{hint}")
    default = parameters[knob].default if knob in parameters else _MISSING
    return spec.params.get(knob, default)


def _known(loaded: type[Method]) -> list[str]:
    """Everything of a method that can be swept."""
    keyword = [
        name
        for name, item in inspect.signature(loaded).parameters.items()
        if item.kind is not inspect.Parameter.VAR_KEYWORD
    ]
    return [*keyword, *(BUDGET + key for key in BudgetSpec.model_fields)]


def _variant(spec: MethodSpec, knob: str, value: Any) -> MethodSpec:
    """``spec`` with one knob at ``value``, just as if it had been written out by hand."""
    if knob.startswith(BUDGET):
        key = knob.removeprefix(BUDGET)
        given = {**spec.budget.given(), key: value}
        try:
            change: dict[str, Any] = {"budget": BudgetSpec.model_validate(given)}
        except ValidationError as error:
            raise InputError(f"{BUDGET}{refusal(BudgetSpec, error)}") from None
    else:
        change = {"params": {**spec.params, knob: value}}
    label = f"{spec.label} {knob}={value}"
    variant = spec.model_copy(update={**change, "label": label, "sweep": None})
    variant.set_apart(spec.label, knob)
    return variant
