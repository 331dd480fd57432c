"""The generated part of docs/suites.md."""

from __future__ import annotations

import json
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from harness.analysis.metrics import of_measure
from harness.core.protocol.method import Budget
from harness.measures import registry as measures
from harness.report.manual.words import KEYS, SETTINGS
from harness.report.parts import KINDS, parts
from harness.suite import load, schema

TITLES = {
    "Suite": "Keys of a suite",
    "MethodSpec": "Keys of a method",
    "BudgetSpec": "Keys of a budget",
    "Profile": "Keys of a profile",
    "ReportSpec": "Keys of a report",
}
_KINDS = {
    "str": "text",
    "int": "whole number",
    "float": "number",
    "bool": "yes or no",
    "dict": "mapping",
    "list": "list",
    "Any": "any",
    "NoneType": "nothing",
}


def manual() -> str:
    """Markdown of everything that a suite may say, and of every number that it gives."""
    blocks = [suites()]
    blocks += [keys(name) for name in TITLES]
    blocks += [report_parts(kind) for kind in KINDS]
    blocks += ["## Measures\n"]
    blocks += [measure(name) for name in measures.names()]
    return "\n".join(blocks)


def suites() -> str:
    """The suites that ship, by their titles."""
    rows = [(f"`{name}`", load.describe(name)) for name in load.names()]
    return _section("## Suites that ship", table(("suite", "title"), rows))


def keys(name: str) -> str:
    """The keys that a schema of a suite has."""
    fields = getattr(schema, name).model_fields
    rows = [
        (f"`{key}`", kind_of(fields[key].annotation), _default(name, key, fields[key]), meaning)
        for key, meaning in KEYS[name].items()
    ]
    return _section(f"## {TITLES[name]}", table(("key", "kind", "default", "meaning"), rows))


def report_parts(kind: str) -> str:
    """Tables or figures by name."""
    rows = [(f"`{part.name}`", part.summary) for part in parts(kind).values()]
    return _section(f"## {kind.capitalize()} of a report", table(("name", "what it is"), rows))


def measure(name: str) -> str:
    """A measure's settings and metrics."""
    kind = measures.load(name)
    facts = [measures.describe(name)]
    facts.append("Timed: methods alternate with the baseline." if kind.timed else "Not timed.")
    facts.append("In every scene." if kind.needs_scene else "Without a scene.")
    parts = [f"### {name}\n", " ".join(facts) + "\n"]
    fields = kind.Settings.model_fields.items()
    rows = [(f"`{k}`", default_of(f), *SETTINGS[k]) for k, f in fields]
    if rows:
        parts.append(table(("setting", "default", "unit", "meaning"), rows))
    metrics = [(f"`{m.name}`", m.unit, m.about) for m in of_measure(name)]
    parts.append(table(("metric", "unit", "meaning"), metrics))
    return "\n".join(parts)


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    lines = [head, ("---",) * len(head), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', '/') for cell in row)} |\n" for row in lines)


def kind_of(annotation: Any) -> str:
    """A type in words."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "mapping"
    if inner := get_args(annotation):
        name = getattr(annotation, "__name__", "")
        if name == "list" or str(annotation).startswith("list["):
            return "list"
        if str(annotation).startswith("dict["):
            return "mapping"
        if hasattr(annotation, "__metadata__"):
            return kind_of(inner[0])
        words = dict.fromkeys(kind_of(each) for each in inner if each is not type(None))
        return " or ".join(words)
    return _KINDS[getattr(annotation, "__name__", "Any")]


def default_of(field: FieldInfo) -> str:
    """A default as it would be written in a suite."""
    if field.is_required():
        return "must be given"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, BaseModel) or value in ("", {}, []):
        return ""
    return f"`{json.dumps(value)}`"


def _default(name: str, key: str, field: FieldInfo) -> str:
    """What holds if no profile, suite or method gives a part of a budget is the protocol's."""
    return f"`{getattr(Budget(), key)}`" if name == "BudgetSpec" else default_of(field)


def _section(title: str, text: str) -> str:
    return f"{title}\n\n{text}"
