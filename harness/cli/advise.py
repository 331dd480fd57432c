"""``harness advise RESULTS_DIR``: which method to use for so many samples."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def advise(
        results_dir: Annotated[Path, typer.Argument(help="A folder that harness run wrote.")],
        material: Annotated[str, typer.Option(help="A material of the suite.")],
        samples: Annotated[
            float,
            typer.Option(
                help="Shading samples, over all pixels, that the baseline would take, as 64e6."
            ),
        ],
        scene: Annotated[
            str | None, typer.Option(help="A scene of the suite; by default each of them.")
        ] = None,
        shipped: Annotated[
            bool, typer.Option("--shipped", help="Fits come with the methods and cost nothing.")
        ] = False,
    ) -> None:
        """Name the fastest method to a given error, the runner-up, and how long that holds."""
        from harness.analysis import advise as reports
        from harness.core.protocol.errors import InputError, nearest
        from harness.store.database import folders_in

        if not results_dir.is_dir():
            beside = [folder.name for folder in folders_in(results_dir.parent)]
            raise InputError(f"no such folder: {results_dir}{nearest(results_dir.name, beside)}")
        for advice in reports.advise(results_dir, material, samples, scene, shipped):
            for line in advice.lines():
                print(line)
