"""Of which changed units the result of a computation tells something, given what of them ran."""

from __future__ import annotations

from collections.abc import Mapping

from harness.identity.coverage import Coverage
from harness.identity.tree import Unit
from harness.identity.units import CLASS, FUNCTION, VALUE

Key = tuple[str, str]


def tried(units: Mapping[Key, Unit], coverage: Coverage) -> frozenset[str]:
    """Values and classes (``module:name``) among the reached ``units`` that were put to the test.

    A module-level value if all regions that read it ran; a class, for what its body says, if all
    that name it or one of its attributes did. Statements that run at import are never: what they do
    may show anywhere. Functions are judged by their own regions.
    """
    found = {key for key, unit in units.items() if unit.kind in (VALUE, CLASS)}

    def ran(user: Key, names: set[str]) -> bool:
        if units[user].kind != FUNCTION:
            return user in found
        covered = coverage.get(str(units[user]))
        return covered is not None and covered.missed_names.isdisjoint(names)

    users = {key: set[Key]() for key in found}
    names = {key: {key[1].rpartition(".")[2], *units[key].attributes} for key in found}
    for user, unit in units.items():
        for target in unit.strong:
            if target in users and target != user:
                users[target].add(user)
        for key in found:
            if key != user and not unit.mentions.isdisjoint(units[key].attributes):
                users[key].add(user)
    while True:
        lost = {key for key in found if not all(ran(user, names[key]) for user in users[key])}
        if not lost:
            return frozenset(str(units[key]) for key in found)
        found -= lost
