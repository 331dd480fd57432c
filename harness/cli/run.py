"""``harness run SUITE.yaml``: fit, measure, store, and print the tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.suites import (
    Device,
    Only,
    Profile,
    Retry,
    Suite,
    failed_again,
    planned,
    report,
    run_and_report,
)


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def run(
        suite: Suite,
        out: Annotated[
            Path | None, typer.Option(help="Results folder; by default results/<suite>.")
        ] = None,
        profile: Profile = None,
        only: Only = None,
        executor: Annotated[
            str | None, typer.Option(help="local (worker processes), dask, or inline (no process).")
        ] = None,
        scheduler: Annotated[
            str | None, typer.Option(help="Of a Dask cluster, such as tcp://HOST:8786.")
        ] = None,
        workers: Annotated[
            int, typer.Option(min=1, help="Fits and untimed measures side by side.")
        ] = 1,
        trial_seconds: Annotated[
            float | None, typer.Option(help="A trial is ended after so long.")
        ] = None,
        trial_memory: Annotated[
            float | None, typer.Option(help="A trial is ended at so many GiB.")
        ] = None,
        retry: Retry = None,
        refit: Annotated[
            bool, typer.Option("--refit", help="Fit all anew, also what comes fitted.")
        ] = False,
        dry_run: Annotated[bool, typer.Option("--dry-run", help="Only list the trials.")] = False,
        device: Device = "cpu",
    ) -> None:
        """Carry out what a suite asks for and is not stored yet, then print its tables."""
        from harness.runner.answer_cache import AnswerCache

        asked = [profile, only, scheduler, workers, trial_seconds, trial_memory, retry, refit]
        command = {"run": [*asked, executor, dry_run, device]}
        answers = AnswerCache(command, suite, out)
        if executor == "dask" or device != "cpu":
            answers.disable()  # workers elsewhere, or a GPU, are not looked at
        if said := answers.find():
            print(said["text"], end="", flush=True)
            if not dry_run:
                report(answers.results, said["allowed"])
            raise typer.Exit(0)

        from harness.core.protocol.errors import InputError
        from harness.runner import executor as executors
        from harness.runner.limits import Limits
        from harness.runner.run import Options
        from harness.suite.load import load

        again = failed_again(retry)
        if executor is not None:
            executors.check(executor)
        if scheduler is not None and executor != executors.DASK:
            raise InputError("--scheduler: expected --executor dask with it")
        limits = Limits(trial_seconds, trial_memory and trial_memory * 2**30)
        loaded, made, machine = load(suite), None, None
        if executor == executors.DASK and not dry_run:
            from harness.runner.cluster import Cluster, connect

            made = Cluster(connect(scheduler, workers), device, limits)
            machine = made.machine()
        plan = planned(loaded, profile, device, machine, answers)
        results = out or Path("results") / plan.suite
        options = Options(only, made or executor, again, dry_run, refit, workers, limits)
        raise typer.Exit(run_and_report(plan, results, options, answers))
