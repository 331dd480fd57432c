"""Reads a YAML file in which every key is given once, and says in one line what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from harness.core.protocol.errors import InputError


def read_yaml(path: Path, expected: str) -> Any:
    """The data in ``path``; :class:`InputError` if it cannot be read or is no YAML.

    ``expected`` completes the refusal, as in "expected a suite in YAML".
    """
    try:
        return parse_yaml(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; expected {expected}") from None


def parse_yaml(text: str, where: str) -> Any:
    """The data in ``text``, which came from ``where``."""
    try:
        return yaml.load(text, Loader=UniqueKeys)
    except yaml.YAMLError as error:
        raise InputError(f"{where}{_position(error)}: not valid YAML: {_problem(error)}") from None


class UniqueKeys(yaml.SafeLoader):
    """YAML in which a key may be given once."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            if isinstance(key_node, yaml.ScalarNode):
                if key_node.value in seen and key_node.value != "<<":
                    what = f"the key '{key_node.value}' is given twice"
                    raise yaml.constructor.ConstructorError(None, None, what, key_node.start_mark)
                seen.add(key_node.value)
        return super().construct_mapping(node, deep)


def _position(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    return f", line {mark.line + 1}" if mark else ""


def _problem(error: yaml.YAMLError) -> str:
    return (getattr(error, "problem", None) or str(error)).partition("\n")[0]
