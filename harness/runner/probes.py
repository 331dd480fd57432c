"""Probes kept with a run's trials, and asked when their code has changed.

One probe stands for all trials that share a part's code: of the first of them that was measured. It
is made once its unit is done, so that no measurement waits, and made again when the digest of the
part is another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from harness.core.registry import oneline
from harness.identity.probe import Probe, difference
from harness.identity.verdict import ADAPTER, BASELINE, MATERIAL, MEASURE, SCENE, short
from harness.runner import probing
from harness.runner.executor import Executor, carry_out
from harness.runner.task import PROBE, Fitted, Task
from harness.runner.validity import Validity
from harness.store import code
from harness.store.files import DamagedFile
from harness.store.folder import ResultsFolder
from harness.suite.plan import Plan
from harness.suite.trials import FIT, Trial

NUMBERS, WORK = "numbers", "work"
"""How much two versions of a part were found to share: the numbers, or what is timed too."""
_WITHOUT_STATE = (MATERIAL, MEASURE, SCENE)


class Probes:
    """The probes of one results folder, which is open for writing; ``execute`` computes them."""

    def __init__(self, plan: Plan, results: ResultsFolder, validity: Validity, execute: Executor):
        self.plan, self.results, self.validity = plan, results, validity
        self.execute = execute
        self._timed = any(trial.timed for trial in plan.trials)
        self.failed: dict[tuple[str, str], str] = {}
        """Why there is no probe, by part and material: if such code changes, all is stale."""
        self._asked: dict[tuple[str, str, str], str] = {}
        self._kept = code.probes(results)

    def keep(self, trials: Iterable[Trial], note: Callable[[str], None]) -> None:
        """Make the probes that are missing for ``trials``, which are stored."""
        for trial in trials:
            parts = self.validity.parts(trial)
            for part in probing.names(parts):
                if part == BASELINE or (part, parts[part]) in self._kept:
                    continue
                note(f"{trial.material}: a probe of {part}, for when the code changes")
                made = self._made(trial, part, self._timed)
                if isinstance(made, str):
                    # Without a probe nothing is known, and a change will be measured again.
                    self._kept[part, parts[part]] = ("", "")
                    self.failed[part, trial.material] = made
                    continue
                about = (trial.hash, self.state(trial, part))
                code.save_probe(self.results, part, parts[part], *about, made.packed())
                self._kept[part, parts[part]] = about

    def _made(self, trial: Trial, part: str, timed: bool) -> Probe | str:
        """The probe of a part as it is now, or why it failed."""
        fit = self.validity.stored.get(trial.fit)
        try:
            fits = {} if fit is None else {trial.fit: Fitted.of(fit)}
            begins = self.validity.begins(trial)
            about = {"part": part, "begins": begins, "timed": timed}
            answer = carry_out(
                self.execute, Task(PROBE, (trial,), self.plan.baseline, fits, **about)
            )
            if answer.probe is not None:
                return Probe.unpacked(answer.probe)
            return answer.died or answer.refused
        except (DamagedFile, ValueError, KeyError) as error:
            return oneline(error)

    def state(self, trial: Trial, part: str) -> str:
        """Digest of the fitted state that a probe of the part uses; "" for none."""
        if part in _WITHOUT_STATE or trial.measure == FIT:
            return ""
        stored = self.validity.stored.get(trial.fit)
        return stored.state if stored else ""

    def same(self, trial: Trial) -> Callable[[str, str, str], bool]:
        """For a verdict on ``trial``: did a changed part change its numbers?"""

        def ask(part: str, old: str, new: str) -> bool:
            # What is the baseline here is the adapter in a trial of its own.
            part = ADAPTER if part == BASELINE else part
            wanted = {WORK} if trial.timed else {WORK, NUMBERS}
            if (part, old, new) not in self._asked:
                self._asked[part, old, new] = self._compare(part, old, new)
            return self._asked[part, old, new] in wanted

        return ask

    def _compare(self, part: str, old: str, new: str) -> str:
        known = code.equivalents(self.results)
        found = [kind for kind in (WORK, NUMBERS) if (part, old, new, kind) in known]
        if found:
            return found[0]
        about = self._kept.get((part, old))
        by_hash = {trial.hash: trial for trial in self.plan.trials}
        if about is None or about[0] not in by_hash:
            return ""
        trial = by_hash[about[0]]
        if self.validity.parts(trial).get(part) != new or self.state(trial, part) != about[1]:
            return ""
        try:
            before = Probe.unpacked(code.probe(self.results, part, old))
        except Exception:
            return ""  # what cannot be compared is measured again
        now = self._made(trial, part, timed=bool(before.work))
        if isinstance(now, str):
            self.failed[part, trial.material] = now
            return ""
        units = code.units(self.results, old), short(self.validity.sources(trial)[part].units)
        trained = trial.measure == FIT and part != MATERIAL
        for kind, timed in ((WORK, True), (NUMBERS, False)):
            if not difference(before, now, *units, timed=timed, trained=trained):
                code.note_equivalent(self.results, part, old, new, kind)
                code.save_probe(self.results, part, new, trial.hash, about[1], now.packed())
                self._kept[part, new] = about
                return kind
        return ""
