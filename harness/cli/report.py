"""``harness report RESULTS_DIR``: tables, figures and html, from stored results only."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def report(
        results_dir: Annotated[Path, typer.Argument(help="A folder that harness run wrote.")],
    ) -> None:
        """Make tables and figures again from what is stored; nothing is computed."""
        from harness.core.protocol.errors import InputError, nearest
        from harness.core.terminal import Screen
        from harness.report import write as reports

        if not results_dir.is_dir():
            beside = [p.parent.name for p in results_dir.parent.glob("*/results.sqlite")]
            raise InputError(f"no such folder: {results_dir}{nearest(results_dir.name, beside)}")
        console = Screen(highlight=False)
        loaded = reports.load(results_dir)
        files = loaded.write(lambda text: console.print(text, soft_wrap=True))
        loaded.print(console)
        for file in files:
            console.print(str(file), soft_wrap=True)
