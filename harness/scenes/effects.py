"""The effects a scene may call for. What a scene does not name is not simulated."""

from __future__ import annotations

from collections.abc import Iterable

EFFECTS: dict[str, str] = {
    "environment": "light that reaches the surface directly from the environment",
}


def checked(effects: Iterable[str], where: str) -> tuple[str, ...]:
    """``effects`` as a tuple without repeats.

    Raises:
        InputError: not a list of known effect names; ``where`` says whose.
    """
    from harness.protocol.errors import InputError, nearest

    if isinstance(effects, str) or not isinstance(effects, Iterable):
        raise InputError(f"{where}: effects: expected a list of names, got {effects!r}")
    found: dict[str, None] = {}
    for effect in effects:
        if not isinstance(effect, str) or effect not in EFFECTS:
            raise InputError(f"{where}: unknown effect {effect!r}{nearest(str(effect), EFFECTS)}")
        found[effect] = None
    if not found:
        raise InputError(f"{where}: effects: expected at least one of {', '.join(EFFECTS)}")
    return tuple(found)
