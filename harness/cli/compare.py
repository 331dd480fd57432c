"""``harness compare RUN AGAIN``: do two runs of a suite agree?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def compare(
        run: Annotated[Path, typer.Argument(help="A folder that harness run wrote.")],
        again: Annotated[Path, typer.Argument(help="One of another run (harness run --out).")],
        metric: Annotated[
            list[str] | None, typer.Option(help="Only this metric; may be given again.")
        ] = None,
    ) -> None:
        """Say how many intervals of two runs overlap, and how wide they are."""
        from harness.analysis.compare import compare as compared

        found, left_out = compared(run, again, tuple(metric or ()))
        for agreement in found:
            for line in agreement.lines():
                print(line)
        for reason in left_out:
            print(f"left out: {reason}")
