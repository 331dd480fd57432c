"""Reads a YAML file in which every key is given once, and says in one line what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from harness.core.plain import DEPTH, check_plain
from harness.core.protocol.errors import InputError
from harness.core.text import one_line

_KEYS = 10_000
"""Of one mapping, with those that it merges."""
BYTES = 2**18
"""Of a file; the largest of the project has a fiftieth of that."""


def read_yaml(path: Path, expected: str) -> Any:
    """The data in ``path``; :class:`InputError` if it cannot be read or is no YAML.

    ``expected`` completes the refusal, as in "expected a suite in YAML".
    """
    return parse_yaml(read_text(path, expected), str(path))


def read_text(path: Path, expected: str) -> str:
    """The text of a file of at most ``BYTES``; see :func:`read_yaml`."""
    try:
        with path.open("rb") as file:
            content = file.read(BYTES + 1)
        if len(content) > BYTES:
            raise InputError(f"{path}: more than {BYTES:,} bytes; expected {expected}")
        return content.decode("utf-8").replace("\r\n", "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; expected {expected}") from None


def parse_yaml(text: str, where: str) -> Any:
    """The data in ``text``, which came from ``where``: plain data (:mod:`harness.core.plain`)."""
    try:
        data = yaml.load(text, Loader=UniqueKeys)
    except yaml.YAMLError as error:
        raise InputError(f"{where}{_position(error)}: not valid YAML: {_problem(error)}") from None
    except RecursionError:
        raise InputError(f"{where}: not valid YAML: something lies within itself") from None
    except (ValueError, OverflowError) as error:
        # A date of no calendar, a number of more digits than can be read.
        said = one_line(str(error))[:100]
        raise InputError(f"{where}: not valid YAML: a value cannot be read: {said}") from None
    check_plain(data, where)
    return data


class UniqueKeys(yaml.SafeLoader):
    """YAML in which a key may be given once, and nothing lies within itself or very deep."""

    def __init__(self, stream: Any):
        super().__init__(stream)
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self._depth += 1
        if self._depth > 4 * DEPTH:
            what = f"lists and mappings more than {DEPTH} deep"
            raise yaml.composer.ComposerError(None, None, what, self.peek_event().start_mark)
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        super().flatten_mapping(node)
        if len(node.value) > _KEYS:
            what = f"a mapping of more than {_KEYS:,} keys"
            raise yaml.constructor.ConstructorError(None, None, what, node.start_mark)

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
    said = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    return one_line(said.partition("\n")[0])[:200]
