"""``harness effects SUITE.yaml``: what each effect costs and changes, and which are needed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def effects(
        suite: Annotated[str, typer.Argument(help="A suite: a .yaml file, or a name of suites/.")],
        out: Annotated[
            Path | None, typer.Option(help="Results folder; by default results/<suite>-effects.")
        ] = None,
        profile: Annotated[
            str | None, typer.Option(help="quick or full; by default quick.")
        ] = None,
        only: Annotated[
            str | None, typer.Option(help="A part of it, such as material=A,scene=B.")
        ] = None,
        method: Annotated[
            str | None,
            typer.Option(help="Method of the suite to render with; by default its baseline."),
        ] = None,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Render each scene without each of its effects, and say which it needs."""
        from rich.console import Console

        from harness.runner import preflight
        from harness.runner.effects import effects_only
        from harness.runner.run import INTERRUPTED, Options
        from harness.runner.run import run as carry_out
        from harness.suite.load import load
        from harness.suite.plan import make_plan

        loaded = effects_only(load(suite), method)
        preflight.ready(device)
        plan = make_plan(loaded, profile, device)
        results = out or Path("results") / f"{plan.suite}-effects"
        console = Console(highlight=False)
        status = carry_out(plan, results, Options(only, "local", False, False), console)
        if status != INTERRUPTED:
            from harness import report

            files = report.make(results)
            report.print_tables(results, console)
            console.print(f"report: {files[0]}", soft_wrap=True)
        raise typer.Exit(status)
