"""For which units the result of a computation speaks, given those that ran as a whole."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from harness.identity.tree import Unit
from harness.identity.units import CLASS, FUNCTION, VALUE

Key = tuple[str, str]


def tried(units: Mapping[Key, Unit], whole: Collection[str]) -> frozenset[str]:
    """Units (``module:name``) among the reached ``units`` that the computation has tried.

    Functions and methods if they are ``whole``. A module-level value if all that read it are; a
    class, for what its body says, if all that mention one of its attributes, and its own methods,
    are. Statements that run at import are never: what they do may show anywhere.
    """
    users: dict[Key, set[Key]] = {key: set() for key in units}
    for key, unit in units.items():
        for target in unit.strong:
            if target in users and units[target].kind == VALUE:
                users[target].add(key)
    for key, unit in units.items():
        if unit.kind == CLASS:
            own = {(key[0], f"{key[1]}.{method}") for method in unit.methods}
            users[key] |= own & units.keys()
            users[key] |= {
                other
                for other, found in units.items()
                if other != key and not unit.attributes.isdisjoint(found.mentions)
            }
    found = {
        key
        for key, unit in units.items()
        if (str(unit) in whole if unit.kind == FUNCTION else unit.kind in (VALUE, CLASS))
    }
    while True:
        # A circle of values and classes is as tried as what uses it.
        lost = {key for key in found if units[key].kind != FUNCTION and not users[key] <= found}
        if not lost:
            return frozenset(str(units[key]) for key in found)
        found -= lost
