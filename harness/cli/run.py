"""``harness run SUITE.yaml``: fit, measure, store, and print the tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def run(
        suite: Annotated[str, typer.Argument(help="A suite: a .yaml file, or a name of suites/.")],
        out: Annotated[
            Path | None, typer.Option(help="Results folder; by default results/<suite>.")
        ] = None,
        profile: Annotated[
            str | None, typer.Option(help="quick or full; by default quick.")
        ] = None,
        only: Annotated[
            str | None, typer.Option(help="A part of it, such as material=A,method=B.")
        ] = None,
        executor: Annotated[str, typer.Option(help="local (dask is to come).")] = "local",
        retry: Annotated[str | None, typer.Option(help="failed: run failed trials again.")] = None,
        refit: Annotated[
            bool, typer.Option("--refit", help="Fit all anew, also what comes fitted.")
        ] = False,
        dry_run: Annotated[bool, typer.Option("--dry-run", help="Only list the trials.")] = False,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Carry out what a suite asks for and is not stored yet, then print its tables."""
        from rich.console import Console

        from harness.protocol import InputError
        from harness.runner import executor as executors
        from harness.runner import preflight
        from harness.runner.run import INTERRUPTED, Options
        from harness.runner.run import run as carry_out
        from harness.suite.load import load
        from harness.suite.plan import make_plan

        if retry not in (None, "failed"):
            raise InputError(f"--retry {retry}: expected 'failed'")
        executors.make(executor)
        loaded = load(suite)
        preflight.ready(device)
        plan = make_plan(loaded, profile, device)
        results = out or Path("results") / plan.suite
        console = Console(highlight=False)
        options = Options(only, executor, retry == "failed", dry_run, refit)
        status = carry_out(plan, results, options, console)
        if not dry_run and status != INTERRUPTED:
            from harness import report

            files = report.make(results)
            report.print_tables(results, console)
            console.print(f"report: {files[0]}", soft_wrap=True)
        raise typer.Exit(status)
