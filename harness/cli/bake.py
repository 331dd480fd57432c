"""``harness bake``: the data base of importance maps of a material."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def bake(
        material: Annotated[str, typer.Option(help="Material by name: a parametric family, ...")],
        slices: Annotated[int, typer.Option(min=1, help="Maps, rounded up to 64s.")] = 2048,
        out: Annotated[
            Path | None, typer.Option(help="Folder; importance-maps/MATERIAL by default.")
        ] = None,
        resume: Annotated[bool, typer.Option("--resume", help="Go on with a folder.")] = False,
        resolution: Annotated[
            int, typer.Option(min=2, help="Cells per side of a map; methods read 32 by default.")
        ] = 32,
        slice_resolution: Annotated[
            int, typer.Option(min=2, help="Cells per side of the slice that a map is made of.")
        ] = 64,
        kind: Annotated[str, typer.Option(help="Kind of map.")] = "optimal-transport",
        seed: Annotated[int, typer.Option(help="Of the conditions.")] = 0,
        workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
        device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
    ) -> None:
        """Bake importance maps of random slices of a material, for fits that name the folder."""
        import time

        from rich.progress import Progress

        from harness.core.outputs import folder_to_fill
        from harness.core.terminal import Screen
        from harness.importance_maps.database import MANIFEST, BakeSettings, bake_to
        from harness.materials import registry

        chosen = registry.make(material)
        settings = BakeSettings(kind, resolution, slice_resolution, seed)
        folder = out or Path("importance-maps") / material
        folder_to_fill(
            folder,
            "--out",
            lambda place: (place / MANIFEST).is_file(),
            "a data base of importance maps",
        )
        console, start = Screen(), time.perf_counter()
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task(f"{kind} maps of {material}", total=slices)
            made = bake_to(
                folder,
                chosen,
                settings,
                slices,
                device=device,
                workers=workers,
                resume=resume,
                notify=lambda done, of: progress.update(task, completed=done, total=of),
            )
        size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
        seconds = time.perf_counter() - start
        console.print(
            f"{folder}: {size:.0f} MB; {made} shards of 64 maps made in {seconds:.0f} s",
            markup=False,
            highlight=False,
        )
