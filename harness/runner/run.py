"""A run: plan, compare with what is stored, carry out the rest, sum up."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from harness.analysis.renew import renew
from harness.core.compiled import library
from harness.core.protocol.errors import InputError
from harness.identity.verdict import WORDS
from harness.measures.base import FAILED
from harness.runner import executor as executors
from harness.runner import known_seconds, preflight, shipped
from harness.runner import only as only_option
from harness.runner.driver import Driver
from harness.runner.executor import Executor
from harness.runner.limits import Limits
from harness.runner.only import Only
from harness.runner.probes import Probes
from harness.runner.progress import Pace, Progress
from harness.runner.todo import Todo, make_todo
from harness.runner.validity import Validity
from harness.store import code, files
from harness.store.database import is_ours
from harness.store.folder import ResultsFolder
from harness.store.lock import locked
from harness.store.mend import mend
from harness.store.stored import DAMAGED
from harness.suite import made_by
from harness.suite.named import files_of
from harness.suite.plan import Plan
from harness.suite.trials import FIT, Trial

if TYPE_CHECKING:
    from harness.runner.cluster import Cluster

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


@dataclass(frozen=True)
class Options:
    """What the command line adds to the plan."""

    only: str | None = None
    executor: str | Cluster | None = None
    retry_failed: bool = False
    dry_run: bool = False
    refit: bool = False
    workers: int = 1
    """Fits and measures that are not timed, side by side."""
    limits: Limits = field(default_factory=Limits)


def run(
    plan: Plan,
    results: Path,
    options: Options,
    console: Console,
    idle: Callable[[], None] = lambda: None,
) -> int:
    """Carry out what is missing; returns the exit status. Reports nothing but itself.

    ``idle`` is called if there was nothing to carry out.
    """
    if isinstance(options.executor, str):
        executors.check(options.executor)
    only = only_option.parse(options.only, plan)
    preflight.check_report(plan)
    if options.dry_run:
        if is_ours(results):
            with ResultsFolder(results) as store:
                todo = _todo(plan, store, only, options, None)
        else:
            todo = make_todo(plan, {}, Validity(plan, {}), only)
        _list(plan, todo, options.refit, console)
        _explain(todo, console)
        idle()
        return 0
    with locked(results):
        mend(results, lambda text: _say(console, text, "yellow"))
        said = _Said()
        made = make_executor(plan, options, lambda text: said.note(text))
        with ResultsFolder(results, write=True) as store, made as execute:
            renew(store)
            todo = _todo(plan, store, only, options, execute)
            preflight.check_trials(plan, todo.trials, execute)
            _write_plan(plan, store)
            _say(console, f"{results}: {_counted(todo)}")
            kernels = library.found() if todo.trials and plan.device == "cpu" else None
            if isinstance(kernels, str):
                _say(console, f"no compiled kernels ({kernels}): {library.WITHOUT}", "yellow")
            if plan.note:
                _say(console, f"profile {plan.profile}: {plan.note}", "yellow")
            for line in made_by.lines(plan.left_out):
                _say(console, line, "yellow")
            _explain(todo, console)
            interrupted = False
            if todo.trials:
                console.record = False  # a line that is drawn anew ten times a second
            elsewhere, ready = _known(todo, options.refit)
            with Progress(
                *(console, todo.trials, todo.stored, execute.slots, elsewhere, ready)
            ) as progress:
                said.note = progress.note
                validity = Validity(plan, todo.stored)
                driver = Driver(
                    plan,
                    store,
                    todo.stored,
                    validity,
                    progress,
                    execute,
                    options.refit,
                    todo.doubtful,
                )
                try:
                    driver.run(todo.units)
                except KeyboardInterrupt:
                    interrupted = True
            store.tidy()
            _without_probes(todo.unprobed | driver.probes.failed, console)
        if interrupted:
            _say(
                console,
                f"interrupted after {progress.done} of {progress.total} trials; they are stored, "
                "and the same command goes on from there",
                "yellow",
            )
            return INTERRUPTED
    if not todo.trials:
        idle()
    return _sum_up(todo, console)


class _Said:
    """Where notes from inside a task go: nowhere before there is something to show them."""

    def note(self, text: str) -> None:
        """Show it."""


def make_executor(plan: Plan, options: Options, note: Callable[[str], None]) -> Executor:
    """The executor that is asked for, for the tasks of a plan."""
    name = options.executor or executors.default
    if name == executors.INLINE:
        from harness.runner.inline import Inline

        return Inline(note, plan.resolved)
    if name == executors.LOCAL:
        from harness.runner.local import Local

        return Local(note, plan.device, options.workers, options.limits)
    from harness.runner.cluster import Cluster, connect

    if isinstance(name, str):
        name = Cluster(connect(None, options.workers), plan.device, options.limits)
    name.carry(plan)
    return name


def _todo(
    plan: Plan, store: ResultsFolder, only: Only, options: Options, execute: Executor | None
) -> Todo:
    """The plan, less what is stored whole and still holds."""
    found = store.trials({trial.hash for trial in plan.trials})
    stored = {key: trial for key, trial in found.items() if trial.status != DAMAGED}
    validity = Validity(plan, stored, lambda digest: code.units(store, digest))
    probes = None if execute is None else Probes(plan, store, validity, execute)
    if probes is not None:
        validity.probed = probes.same
    todo = make_todo(plan, stored, validity, only, options.retry_failed, options.refit)
    if probes is not None:
        todo.unprobed = probes.failed
    return todo


def _write_plan(plan: Plan, store: ResultsFolder) -> None:
    """The suite as run, and the trials it stands for."""
    command = ["--profile", plan.profile] if plan.profile else []
    command += ["--device", plan.device]
    text = f"# As run, with {shlex.join(command)}\n{plan.text}"
    try:
        files.put(store.folder / "suite.yaml", text.encode())
    except OSError as error:
        raise InputError(f"{store.folder}: cannot be written: {error.strerror}") from error
    head = {
        "suite": plan.suite,
        "title": plan.title,
        "profile": plan.profile,
        "device": plan.device,
        "baseline": plan.baseline,
        "report": plan.report,
        "files": files_of(plan),
        "left_out": plan.left_out,
        **{f"{key}s": plan.labels(key) for key in ("material", "method", "scene", "measure")},
    }
    rows = [
        {"trial": t.hash, **t.labels, "fit": t.fit, "identity": t.identity} for t in plan.trials
    ]
    store.write_plan(head, rows)


def _explain(todo: Todo, console: Console) -> None:
    """Why stored numbers are measured again, and which stand although their code changed."""
    asked = {trial.hash for trial in todo.selected}
    kept = Counter(v.sentence for h, v in todo.equivalent.items() if h in asked)
    for sentence, count in kept.most_common():
        _say(console, f"  {_trials(count)} {sentence}", "dim")
    wanted = {trial.hash for trial in todo.trials}
    counts = Counter(v.sentence for h, v in todo.stale.items() if h in wanted)
    for sentence, count in counts.most_common():
        _say(console, f"  {_trials(count)} {sentence}", "yellow")


def _without_probes(failed: dict[tuple[str, str], str], console: Console) -> None:
    """Of which code it will not be known whether a change of it changes numbers, and why."""
    found: dict[tuple[str, str], list[str]] = {}
    for (part, material), why in failed.items():
        found.setdefault((part, why), []).append(material)
    for (part, why), materials in found.items():
        where = f"{materials[0]}{f' and {len(materials) - 1} more' if len(materials) > 1 else ''}"
        _say(console, f"  no probe of {WORDS[part]} ({where}): {why}", "dim")


def _counted(todo: Todo) -> str:
    """``264 trials, 64 to do (11 of them fits), 20 more if a fit comes out different``."""
    trials = [trial for trial in todo.trials if trial.hash not in todo.doubtful]
    fits = sum(trial.measure == FIT for trial in trials)
    text = f"{_trials(len(todo.selected))}, "
    if not trials:
        return text + "all stored"
    text += f"{len(trials)} to do ({fits} of them fits)"
    more = len(todo.doubtful)
    return text + (f", {more} more if a fit comes out different" if more else "")


def _list(plan: Plan, todo: Todo, refit: bool, console: Console) -> None:
    if todo.trials:
        # All at once: a table of a thousand trials takes a second line by line.
        _say(console, "\n".join(f"{trial.hash}  {trial}" for trial in todo.trials))
    elsewhere, ready = _known(todo, refit)
    work = [trial for trial in todo.trials if trial.hash not in ready]
    left = str(Pace(work, todo.stored, elsewhere=elsewhere))
    _say(console, f"{plan.suite}: {_counted(todo)}{', ' + left if left else ''}; nothing was run")


def _known(todo: Todo, refit: bool) -> tuple[dict[known_seconds.Key, float], set[str]]:
    """What is known of how long trials take, and the fits that take no time."""
    ready = set() if refit else {trial.hash for trial in todo.trials if shipped.find(trial)}
    work = (trial for trial in todo.trials if trial.hash not in ready)
    return known_seconds.of(work, todo.seen), ready


def _sum_up(todo: Todo, console: Console) -> int:
    """Print how the selected trials ended, and why some failed; the exit status."""
    concerned = {t.hash: t for t in [*todo.selected, *todo.trials]}
    found = [(trial, todo.stored[h]) for h, trial in concerned.items() if h in todo.stored]
    counts = Counter(stored.status for _, stored in found)
    shown = ", ".join(f"{n} {status}" for status, n in counts.most_common())
    failed = any(counts[status] for status in FAILED)
    _say(console, f"{_trials(len(found))}: {shown}", "red" if failed else "green")
    reasons: dict[tuple[str, str], list[Trial]] = {}
    for trial, stored in found:
        if stored.status != "ok":
            reasons.setdefault((stored.status, stored.reason), []).append(trial)
    for (status, reason), trials in reasons.items():
        more = f" (and {len(trials) - 1} more)" if len(trials) > 1 else ""
        style = "red" if status in FAILED else "yellow"
        _say(console, f"  {status}: {trials[0]}{more}: {reason}", style)
    findings = Counter(finding for _, stored in found for finding in stored.findings)
    for finding, count in findings.most_common():
        _say(console, f"  finding ({_trials(count)}): {finding}", "yellow")
    if failed:
        _say(
            console,
            "harness status --failed shows the traceback of a failed trial; "
            "--retry failed runs the failed ones again.",
        )
    return 1 if failed else 0


def _trials(count: int) -> str:
    return f"{count} trial{'' if count == 1 else 's'}"


def _say(console: Console, text: str, style: str = "") -> None:
    console.print(Text(text, style=style), soft_wrap=True)
    console.file.flush()
