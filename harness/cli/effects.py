"""``harness effects SUITE.yaml``: what each effect costs and changes, and which are needed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.suites import Device, Profile, Suite, planned, run_and_report


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def effects(
        suite: Suite,
        out: Annotated[
            Path | None, typer.Option(help="Results folder; by default results/<suite>-effects.")
        ] = None,
        profile: Profile = None,
        only: Annotated[
            str | None, typer.Option(help="A part of it, such as material=A,scene=B.")
        ] = None,
        method: Annotated[
            str | None,
            typer.Option(help="Method of the suite to render with; by default its baseline."),
        ] = None,
        device: Device = "cpu",
    ) -> None:
        """Render each scene without each of its effects, and say which it needs."""
        from harness.runner.effects import effects_only
        from harness.runner.run import Options
        from harness.suite.load import load

        plan = planned(effects_only(load(suite), method), profile, device)
        results = out or Path("results") / f"{plan.suite}-effects"
        raise typer.Exit(run_and_report(plan, results, Options(only)))
