"""``harness fit SUITE.yaml``: fit all methods of a suite and keep them with the harness."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from harness.cli.suites import Device, Only, Profile, Retry, Suite, failed_again, planned


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def fit(
        suite: Suite,
        results: Annotated[
            Path | None, typer.Option(help="Results folder; by default results/<suite>.")
        ] = None,
        out: Annotated[
            Path | None, typer.Option(help="Where the fits go; by default RESULTS/fitted.")
        ] = None,
        profile: Profile = None,
        only: Only = None,
        retry: Retry = None,
        device: Device = "cpu",
    ) -> None:
        """Run the fits that are not stored yet, and write all to files beside the results.

        With --out harness/fitted they come with the harness: every run then takes such a fit for
        its own, with the time and the machine that it took, unless it is told to --refit.
        """
        from harness.core.outputs import file_to_write, folder_to_fill
        from harness.core.terminal import Screen
        from harness.runner import shipped
        from harness.runner.only import parse
        from harness.runner.run import Options
        from harness.runner.run import run as carry_out
        from harness.store.folder import ResultsFolder
        from harness.suite.load import load
        from harness.suite.trials import FIT

        again = failed_again(retry)
        plan = planned(load(suite), profile, device)
        folder = results or Path("results") / plan.suite
        fits_folder = out or folder / "fitted"
        console = Screen(highlight=False)
        chosen = f"{only},measure={FIT}" if only else f"measure={FIT}"
        if out is not None:
            folder_to_fill(out, "--out", shipped.is_folder_of_fits, "fitted samplers")
            for trial in plan.trials:
                if trial.measure == FIT and (out / shipped.name_of(trial)).exists():
                    name = out / shipped.name_of(trial)
                    file_to_write(name, "--out: in it", shipped.is_fit, "a fitted sampler")
        status = carry_out(plan, folder, Options(chosen, None, again, refit=True), console)
        # An interrupted run, too, leaves fits that are finished.
        wanted = parse(chosen, plan)
        with ResultsFolder(folder) as store:
            there = store.trials()
        fits = [t for t in plan.trials if t in wanted and t.hash in there]
        written = [shipped.save(t, there[t.hash], fits_folder) for t in fits]
        size = sum(path.stat().st_size for path in written if path)
        count = sum(path is not None for path in written)
        console.print(f"{count} fitted samplers in {fits_folder}, {size / 1e6:.1f} MB")
        raise typer.Exit(status)
