"""Whether stored numbers still hold: what a trial was measured with, against what is there now."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

State = Literal["valid", "equivalent", "stale"]

ADAPTER, TRAINING, FIT = "adapter", "training", "fit"
MATERIAL, SCENE, MEASURE = "material", "scene", "measure"
MATERIAL_FILES, SCENE_FILES, METHOD_FILES = "material files", "scene files", "method files"
VERSIONS = "versions"
KERNELS = "kernels"
"""Of a trial whose numbers are times: which compiled kernels ran, if any."""
BASELINE, BASELINE_STATE = "baseline", "baseline state"
"""Of a timed trial, whose numbers are in comparison with the baseline."""

SOURCES = (ADAPTER, TRAINING, MATERIAL, SCENE, MEASURE, BASELINE)
"""Parts that are source text: where only that changed, a probe can tell whether numbers did."""

WORDS = {
    ADAPTER: "the method",
    TRAINING: "the method's training",
    MATERIAL: "the material's evaluator",
    SCENE: "what makes the scene",
    MEASURE: "the measure",
    MATERIAL_FILES: "a file of the material",
    SCENE_FILES: "a file that the scene names",
    METHOD_FILES: "a file that the method's parameters name",
    VERSIONS: "a library's version",
    KERNELS: "what runs networks on the CPU",
    FIT: "the fitted state",
    BASELINE: "the baseline",
    BASELINE_STATE: "the baseline's fitted state",
}
PLACES = frozenset(
    {
        "harness/core/paths.py: METHODS",
        "harness/core/paths.py: ROOT",
        "harness/core/paths.py: SUITES",
        "harness/core/registry.py: IMPORTED_FROM",
        "harness/core/registry.py: METHODS",
        "harness/core/registry.py: METHODS_PACKAGE",
        "harness/core/registry.py: _import",
        "harness/core/registry.py: find",
        "harness/microgeometry/descriptions.py: DESCRIPTIONS",
    }
)
"""Units that say where a file or a class of ours is, as :func:`changed_units` names them. They hold
no arithmetic, and what they find counts by itself: a class is where a part begins, a file is
compared by its content."""
SHORT = 8
_SHOWN = 3


@dataclass(frozen=True)
class Verdict:
    """``state`` of a stored trial, the parts that ``changed``, and a sentence for people.

    ``equivalent``: code changed, and a probe found that numbers did not. Both that and ``valid``
    let the numbers stand.
    """

    state: State
    changed: tuple[str, ...] = ()
    sentence: str = "valid"

    @property
    def stands(self) -> bool:
        """Whether the stored numbers are current."""
        return self.state != "stale"


def judge(
    stored: Mapping[str, str],
    current: Mapping[str, str],
    same: Callable[[str, str, str], bool] | None = None,
    details: Callable[[str, str, str], Iterable[str]] | None = None,
) -> Verdict:
    """Compare digests by part, as stored with a trial and as they are now.

    ``same(part, stored digest, current digest)`` is asked of every source part that differs: does
    a probe show that the numbers did not change? ``details`` names what differs in a part, for the
    sentence; see :func:`changed_units`. Where no more than :data:`PLACES` differ, no probe is
    needed: the numbers did not change.
    """
    differing = [part for part in current if stored.get(part) != current[part]]
    differing += [part for part in stored if part not in current]
    if not differing:
        return Verdict("valid")
    stale = [
        part
        for part in differing
        if part not in SOURCES
        or part not in stored
        or part not in current
        or not (
            _only_places(part, stored[part], current[part], details)
            or (same is not None and same(part, stored[part], current[part]))
        )
    ]
    concerned = stale or differing
    shown = [_shown(part, stored.get(part), current.get(part), details) for part in concerned]
    if stale:
        return Verdict("stale", tuple(stale), f"stale: {', '.join(shown)}")
    return Verdict(
        "equivalent", tuple(differing), f"valid: {', '.join(shown)}; the numbers did not"
    )


def _only_places(
    part: str,
    stored: str,
    current: str,
    details: Callable[[str, str, str], Iterable[str]] | None,
) -> bool:
    """Whether two versions of a part are known to differ in :data:`PLACES` alone."""
    found = list(details(part, stored, current)) if details else []
    return bool(found) and PLACES.issuperset(found)


def _shown(
    part: str,
    stored: str | None,
    current: str | None,
    details: Callable[[str, str, str], Iterable[str]] | None,
) -> str:
    words = WORDS.get(part, part)
    if stored is None:
        return f"it is not known what {words} was"
    if current is None:
        return f"{words} is no longer part of it"
    found = list(details(part, stored, current)) if details else []
    if not found:
        return f"{words} changed"
    more = f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
    return f"{words} changed ({', '.join(found[:_SHOWN])}{more})"


def short(units: Mapping[str, str]) -> dict[str, str]:
    """Hashes as they are stored, shortened: they only have to tell two versions apart."""
    return {unit: value[:SHORT] for unit, value in units.items()}


def changed_units(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Units (or files) of two maps name -> hash that differ, as ``harness/x/y.py: Class.method``.

    A unit that only moved is not among them.
    """
    before, after = _by_name(old), _by_name(new)
    found = []
    for name in dict.fromkeys([*after, *before]):
        if {h for _, h in before.get(name, ())} != {h for _, h in after.get(name, ())}:
            where = sorted(after.get(name) or before[name])[0][0]
            found.append(_place(where, name))
    return sorted(found)


def _by_name(units: Mapping[str, str]) -> dict[str, list[tuple[str, str]]]:
    found: dict[str, list[tuple[str, str]]] = {}
    for key, value in units.items():
        module, _, name = key.rpartition(":")
        found.setdefault(name, []).append((module, value))
    return found


def _place(module: str, name: str) -> str:
    if not module:
        return name
    text = "statements" if name.startswith("<") else name
    return f"{module.replace('.', '/')}.py: {text}"
