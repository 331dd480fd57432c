"""The forms of methods that ``harness tune`` has found, as a suite reads them.

A suite with ``tuned: FILE`` takes the parameters of its methods from there, by label; what the
suite itself says of a parameter goes before.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.core.yamlfile import read_yaml
from harness.suite.schema import MethodSpec

EXPECTED = "what harness tune writes, a mapping with 'methods'"


def with_tuned(methods: list[MethodSpec], path: Path) -> list[MethodSpec]:
    """``methods`` with the parameters that the file at ``path`` has for their labels.

    Raises:
        InputError: the file is not there, is something else, or names none of the methods.
    """
    if not path.is_file():
        raise InputError(f"tuned: no such file: {path}; 'harness tune' writes it")
    data = read_yaml(path, EXPECTED)
    found = data.get("methods") if isinstance(data, dict) else None
    if not isinstance(found, dict):
        raise InputError(f"tuned: {path}: expected {EXPECTED}")
    if not {method.label for method in methods} & set(found):
        raise InputError(f"tuned: {path}: has none of the suite's methods")
    return [
        method.model_copy(
            update={"params": {**_params(found[method.label], path), **method.params}}
        )
        if method.label in found
        else method
        for method in methods
    ]


def _params(entry: Any, path: Path) -> dict[str, Any]:
    params = entry.get("params") if isinstance(entry, dict) else None
    if not isinstance(params, dict):
        raise InputError(f"tuned: {path}: expected 'params' under every method")
    return params
