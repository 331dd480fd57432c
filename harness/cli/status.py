"""``harness status DIR``: what is valid, stale, missing or failed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def status(
        results_dir: Annotated[
            Path, typer.Argument(help="A folder that harness run wrote, or one that holds several.")
        ] = Path("results"),
        failed: Annotated[
            bool, typer.Option("--failed", help="Also the tracebacks of failed trials.")
        ] = False,
    ) -> None:
        """Say what of stored results still holds, and what changed where it does not.

        Exit status 0 if all is valid, else 1. Code is compared with that which measured; nothing
        is computed.
        """
        from harness.analysis import status as statuses
        from harness.analysis.validity import said_of_earlier
        from harness.core.protocol.errors import InputError

        found = statuses.folders(results_dir)
        if not found:
            raise InputError(f"{results_dir}: holds no results, and no folder in it does")
        fine = True
        for folder in found:
            one = statuses.status(folder)
            fine &= one.all_valid
            print(one.line())
            for reason, count in one.reasons.most_common():
                print(f"  {count} x {reason}")
            if one.earlier:
                print(f"  {said_of_earlier(one.earlier)}")
            for finding, count in one.findings.most_common():
                print(f"  {count} x finding: {finding}")
            for trial in one.failed if failed else ():
                labels = " · ".join(str(v) for v in trial.labels.values() if v != "")
                print(f"  {trial.hash} {labels}\n{trial.traceback or trial.reason}")
        raise typer.Exit(0 if fine else 1)
