"""What the verbs that run a suite share: their arguments, the plan, and the report at the end."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from harness.runner.answer_cache import AnswerCache
    from harness.runner.run import Options
    from harness.suite.load import Loaded
    from harness.suite.plan import Plan

Suite = Annotated[str, typer.Argument(help="A suite: a .yaml file, or a name of suites/.")]
Profile = Annotated[
    str | None, typer.Option(help="quick, full, or fast for rough numbers; by default quick.")
]
Only = Annotated[str | None, typer.Option(help="A part of it, such as material=A,method=B,C.")]
Retry = Annotated[str | None, typer.Option(help="failed: run failed trials again.")]
Device = Annotated[str, typer.Option(help="cpu or cuda.")]


def failed_again(retry: str | None) -> bool:
    """Whether ``--retry`` was given.

    Raises:
        InputError: it asks for something else than ``failed``.
    """
    from harness.core.protocol.errors import InputError

    if retry not in (None, "failed"):
        raise InputError(f"--retry {retry}: expected 'failed'")
    return retry == "failed"


def planned(
    loaded: Loaded,
    profile: str | None,
    device: str,
    on: dict[str, Any] | None = None,
    answers: AnswerCache | None = None,
) -> Plan:
    """The suite's trials, on a machine that can run them; times are of the machine ``on``, by
    default of this one."""
    from harness.runner import preflight, shipped
    from harness.suite.plan import make_plan

    preflight.ready(device)
    plan = make_plan(loaded, profile, device, shipped.find)
    for said in dict.fromkeys(map(shipped.damaged, plan.trials)):
        if said:
            print(said, file=sys.stderr, flush=True)
            if answers is not None:
                answers.disable()
    return plan


def run_and_report(
    plan: Plan, results: Path, options: Options, answers: AnswerCache | None = None
) -> int:
    """Carry out what is not stored, then write the report and print its tables; the exit status.

    If there was nothing to carry out, that is kept in ``answers``.
    """
    from harness.core.terminal import Screen
    from harness.runner.only import parse
    from harness.runner.run import INTERRUPTED, run

    console, idle = Screen(highlight=False, record=True), list[bool]()
    status = run(plan, results, options, console, lambda: idle.append(True))
    text = console.export_text() if idle else ""
    if status == INTERRUPTED:
        return status
    allowed = {key: sorted(labels) for key, labels in parse(options.only, plan).allowed.items()}
    if not options.dry_run:
        report(results, allowed)
    if answers is not None and idle and status == 0:
        answers.keep({"text": text, "allowed": allowed})
    return status


def report(results: Path, allowed: Mapping[str, Collection[str]]) -> None:
    """Write the report, and print the part of it with these labels by column."""
    from harness.core.terminal import Screen
    from harness.report import write as reports

    console = Screen(highlight=False)
    loaded = reports.load(results)
    files = loaded.write()
    loaded.of_part(allowed).print(console)
    console.print(f"report: {files[0]}", soft_wrap=True)
