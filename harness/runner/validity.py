"""What planned trials stand on now, and whether stored numbers still hold."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from harness.analysis.renew import OUTDATED, analysis_digest, outdated
from harness.core import machine, registry
from harness.core.compiled import library
from harness.identity.digests import Digests, Part, SourceDigest
from harness.identity.ours import digests
from harness.identity.verdict import (
    ADAPTER,
    BASELINE,
    BASELINE_STATE,
    KERNELS,
    SCENE,
    VERSIONS,
    Verdict,
    changed_units,
    judge,
    short,
)
from harness.identity.verdict import FIT as STATE_PART
from harness.measures import registry as measures
from harness.scenes.base import Scene
from harness.store.stored import Stored
from harness.suite import source_parts
from harness.suite.plan import Plan
from harness.suite.trials import FIT, Trial


class Validity:
    """Digests of the parts of a plan's trials. ``stored`` may grow: fitted states are in it."""

    def __init__(
        self,
        plan: Plan,
        stored: Mapping[str, Stored],
        units: Callable[[str], Mapping[str, str]] = lambda digest: {},
    ):
        self.plan, self.stored, self.units = plan, stored, units
        self.known = _as_edited(plan)
        self.probed: Callable[[Trial], Callable[[str, str, str], bool]] | None = None
        self._parts: dict[tuple, dict[str, Part]] = {}
        self._analyses: dict[str, str] = {}
        self._sources: dict[tuple, dict[str, SourceDigest]] = {}

    def parts(self, trial: Trial) -> dict[str, str]:
        """A digest per part, as they are now; of a fit that is not stored yet "" for its state."""
        found = {name: source.digest for name, source in self.sources(trial).items()}
        found[VERSIONS] = ", ".join(f"{k} {v}" for k, v in machine.versions().items())
        here = trial.identity.get("machine") == machine.identity(self.plan.device)
        if here and library.name() != library.FALLBACK:
            found[KERNELS] = library.name()
        for part, fit in self._fits(trial).items():
            found[part] = self._state(fit)
        if self._compared(trial):
            found[BASELINE] = self.sources(self.plan.baseline_of(trial))[ADAPTER].digest
        return found

    def begins(self, trial: Trial) -> dict[str, Part]:
        """Where the code of each part begins."""
        return self._of(trial)

    def entries(self, trial: Trial) -> dict[str, Any]:
        """Where the code of each part begins, as plain data."""
        return {n: [[*p.entries], [*p.mentions]] for n, p in self._of(trial).items()}

    def analysis(self, measure: str) -> str:
        """Digest of what makes the measure's records."""
        if measure not in self._analyses:
            self._analyses[measure] = analysis_digest(measure)
        return self._analyses[measure]

    def sources(self, trial: Trial) -> dict[str, SourceDigest]:
        """Digest and units of each part that is source code."""
        key = self._key(trial)
        if key not in self._sources:
            parts, fits = self._of(trial), trial.measure == FIT
            # Most trials of a suite share their code: many materials are of one kind.
            shared = (fits, *parts.items())
            if shared not in self._sources:
                self._sources[shared] = source_parts.of_trial(self.known, parts, fits)
            self._sources[key] = self._sources[shared]
        return self._sources[key]

    def verdict(self, trial: Trial) -> Verdict:
        """Of the stored trial, which is there.

        Where only code changed, ``probed(trial)`` gives who is asked whether the numbers did.

        A fit that is not stored says nothing yet: made again it may give the same state.
        """
        sources = {s.digest: s.units for s in self.sources(trial).values()}

        def details(part: str, old: str, new: str) -> list[str]:
            before, after = self.units(old), sources.get(new)
            return changed_units(before, short(after)) if before and after else []

        before, now = dict(self.stored[trial.hash].parts), self.parts(trial)
        for part, fit in self._fits(trial).items():
            if fit not in self.stored:
                before.pop(part, None)
                now.pop(part, None)
        found = judge(before, now, self.probed(trial) if self.probed else None, details)
        return OUTDATED if found.stands and outdated(self.stored[trial.hash]) else found

    def stands(self, trial: Trial) -> bool:
        """Whether a trial is stored and its numbers are current."""
        return trial.hash in self.stored and self.verdict(trial).stands

    def _fits(self, trial: Trial) -> dict[str, str]:
        """Keys of the fits whose states are parts of the trial, by part."""
        found = {STATE_PART: trial.fit} if trial.fit else {}
        if self._compared(trial):
            found[BASELINE_STATE] = self.plan.baseline_of(trial).fit
        return found

    def _compared(self, trial: Trial) -> bool:
        return trial.timed and trial.method != self.plan.baseline

    def _of(self, trial: Trial) -> dict[str, Part]:
        key = self._key(trial)
        if key not in self._parts:
            self._parts[key] = source_parts.parts_of(
                self.known,
                trial.method_name,
                trial.material_spec,
                measures.load(trial.measure),
                self._scene(trial) if trial.scene else None,
            )
        return self._parts[key]

    def _scene(self, trial: Trial) -> Part:
        def make() -> Part:
            scene = self.plan.resolved.scene(trial)
            shapes = scene.shapes if isinstance(scene, Scene) else ()
            around = {json.dumps(s.material): s.material for s in shapes if s.material}
            return source_parts.scene(trial.scene_spec, scene, around.values())

        return self.known.remembered((SCENE, repr(trial.scene_spec)), make)

    def _state(self, fit: str) -> str:
        stored = self.stored.get(fit)
        return stored.state if stored else ""

    def _key(self, trial: Trial) -> tuple:
        return trial.method_name, repr(trial.material_spec), trial.measure, repr(trial.scene_spec)


_STAMPS: dict[Path, int] = {}
"""When adapters were last edited that this process has looked at."""


def _as_edited(plan: Plan) -> Digests:
    """Digests of the source tree; read anew if an adapter was edited since this process read it.

    The registry imports such an adapter again, so that the code that runs is the edited one.
    """
    now = {}
    for name in dict.fromkeys(trial.method_name for trial in plan.trials):
        file = registry.find(name).file
        now[file] = file.stat().st_mtime_ns
    if any(_STAMPS.get(file, stamp) != stamp for file, stamp in now.items()):
        digests.cache_clear()
    _STAMPS.update(now)
    return digests()
