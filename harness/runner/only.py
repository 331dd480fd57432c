"""``--only material=A,method=B,C``: which of the planned trials a run is about."""

from __future__ import annotations

from dataclasses import dataclass

from harness.core.protocol.errors import InputError, nearest
from harness.suite.plan import Plan
from harness.suite.trials import Trial

KEYS = ("material", "method", "scene", "measure")


@dataclass(frozen=True)
class Only:
    """Allowed labels per key; a key that is not there allows all."""

    allowed: dict[str, frozenset[str]]

    def __contains__(self, trial: Trial) -> bool:
        # A trial without a scene is no trial of the scene asked for.
        return all(getattr(trial, key) in values for key, values in self.allowed.items())


def parse(text: str | None, plan: Plan) -> Only:
    """Read the option; every name in it must be one of the plan's.

    A part without a key goes on with the key before it: ``method=A,B`` allows both.
    """
    allowed: dict[str, set[str]] = {}
    last = ""
    for part in (text or "").split(","):
        if not part.strip():
            continue
        key, equals, value = (piece.strip() for piece in part.partition("="))
        # A label may have an equals sign of its own: histogram-mixture (loss=kl).
        if last and (not equals or part.strip() in plan.labels(last)):
            key, equals, value = last, "=", part.strip()
        last = key
        if key not in KEYS or not equals:
            hint = nearest(key, KEYS) if key not in KEYS else ""
            raise InputError(
                f"--only {part.strip()}: expected KEY=NAME, with {', '.join(KEYS)} as key{hint}"
            )
        known = plan.labels(key)
        # A method may also be called by the name that the registry knows it by.
        named = {t.method for t in plan.trials if key == "method" and t.method_name == value}
        chosen = {value} if value in known else named
        if not chosen:
            raise InputError(
                f"--only {part.strip()}: no {key} '{value}' in {plan.where}{nearest(value, known)}"
            )
        allowed.setdefault(key, set()).update(chosen)
    return Only({key: frozenset(values) for key, values in allowed.items()})
