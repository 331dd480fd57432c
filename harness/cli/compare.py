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
        again: Annotated[
            list[Path],
            typer.Argument(help="One of another run; with --html, more of them for a history."),
        ],
        metric: Annotated[
            list[str] | None, typer.Option(help="Only this metric; may be given again.")
        ] = None,
        html: Annotated[
            bool, typer.Option("--html", help="Write a page: what moved, what cannot be compared.")
        ] = False,
        out: Annotated[Path, typer.Option(help="The page's file.")] = Path("comparison.html"),
    ) -> None:
        """Say how many intervals of two runs overlap, and how wide they are."""
        from harness.analysis.compare import compare as compared
        from harness.core.protocol.errors import InputError

        if html:
            if metric:
                raise InputError("--metric: not with --html, whose page can be filtered")
            from harness.report.page.comparison import comparison
            from harness.report.place import write_page

            text = comparison([run, *again])
            write_page(out, text, "--out")
            print(str(out))
            return
        if len(again) > 1:
            raise InputError(f"{again[1]}: two runs are compared; a history of more takes --html")
        found, left_out = compared(run, again[0], tuple(metric or ()))
        for agreement in found:
            for line in agreement.lines():
                print(line)
        for reason in left_out:
            print(f"left out: {reason}")
