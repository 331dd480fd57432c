"""What the verbs that run a suite share: their arguments, the plan, and the report at the end."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
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
    loaded: Loaded, profile: str | None, device: str, on: dict[str, Any] | None = None
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
    return plan


def run_and_report(plan: Plan, results: Path, options: Options) -> int:
    """Carry out what is not stored, then write the report and print its tables; the exit status."""
    from harness.core.terminal import Screen
    from harness.runner.run import INTERRUPTED, run

    console = Screen(highlight=False)
    status = run(plan, results, options, console)
    if not options.dry_run and status != INTERRUPTED:
        from harness.report import write as reports
        from harness.runner.only import parse

        loaded = reports.load(results)
        files = loaded.write()
        loaded.of_part(parse(options.only, plan).allowed).print(console)
        console.print(f"report: {files[0]}", soft_wrap=True)
    return status
