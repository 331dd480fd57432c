"""Methods and their variants: what a plan's trials say about which knob was turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from harness.analysis.results import MethodColumn, Results

_ABSENT = "absent"


@dataclass(frozen=True)
class Family:
    """All methods of one registry name. ``base`` is the one that the suite lists first.

    ``turned`` maps the label of every variant that differs from the base in one setting to
    that setting and its value; the name of a budget's entry begins with ``budget.``.
    """

    base: MethodColumn
    members: list[MethodColumn]
    turned: dict[str, tuple[str, Any]]

    def short(self, label: str) -> str:
        """How a member is called beside its family: ``bins=5``; the base by its own label."""
        if label in self.turned:
            return "{}={}".format(*self.turned[label])
        return label

    def paths(self) -> list[list[str]]:
        """Labels of the variants of each knob, by value where it has an order; no base."""
        knobs: dict[str, list[tuple[Any, str]]] = {}
        for label, (knob, value) in self.turned.items():
            knobs.setdefault(knob, []).append((value, label))
        return [
            [label for _, label in (sorted(pairs) if _numbers(pairs) else pairs)]
            for pairs in knobs.values()
        ]


def families(results: Results) -> list[Family]:
    """Families in the order of their bases."""
    settings = {row["method"]: _settings(row) for row in results.plan["trials"]}
    found: dict[str, list[MethodColumn]] = {}
    for method in results.methods:
        found.setdefault(method.name, []).append(method)
    made = []
    for members in found.values():
        base = members[0]
        turned = {}
        for member in members[1:]:
            changed = _changed(settings.get(base.label, {}), settings.get(member.label, {}))
            if len(changed) == 1:
                turned[member.label] = changed[0]
        made.append(Family(base, members, turned))
    return made


def _settings(row: dict[str, Any]) -> dict[str, Any]:
    """Parameters and budget of a planned trial, flat."""
    method = row["identity"].get("method")
    if not isinstance(method, dict):
        return {}
    budget = {f"budget.{key}": value for key, value in (method.get("budget") or {}).items()}
    return {**(method.get("params") or {}), **budget}


def _changed(base: dict[str, Any], other: dict[str, Any]) -> list[tuple[str, Any]]:
    """What ``other`` has that ``base`` has not, or has with another value."""
    keys = [*other, *(key for key in base if key not in other)]
    return [
        (key, other.get(key, _ABSENT))
        for key in keys
        if base.get(key, _ABSENT) != other.get(key, _ABSENT)
    ]


def _numbers(pairs: list[tuple[Any, str]]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v, _ in pairs)
