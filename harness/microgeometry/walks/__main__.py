"""``python -m harness.microgeometry.walks sheet OUT.png`` and ``... speed``."""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer

from harness.core.outputs import file_to_write
from harness.core.pictures import MARK, marked
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.microgeometry.walks import preview, surfaces

app = typer.Typer(add_completion=False, help="Pictures and speed of random walks.")


@app.command()
def sheet(
    out: Annotated[Path, typer.Argument(help="The PNG to write.")],
    name: Annotated[list[str] | None, typer.Option(help="Descriptions; all by default.")] = None,
    pixels: Annotated[int, typer.Option(help="Side of each picture, an even number.")] = 128,
    count: Annotated[int, typer.Option(help="Particles a channel and picture.")] = 1 << 19,
    device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
) -> None:
    """A sheet of surfaces for walks: from above, and where particles from three sides leave."""
    from matplotlib.image import imsave

    file_to_write(out, "OUT", marked, "a picture of this command")
    strips = []
    for item in name or surfaces.names():
        surface = surfaces.load(item)
        strips.append(preview.strip(surface, pixels // 2 * 2, count, device))
        typer.echo(f"{item}: {preview.about(surface)}")
    imsave(out, np.concatenate(strips), metadata=MARK)


@app.command()
def speed(
    name: Annotated[str, typer.Argument(help="A description.")] = "bronze-grains",
    count: Annotated[int, typer.Option(help="Particles per repeat.")] = 1 << 20,
    repeats: Annotated[int, typer.Option(help="Timed walks, after one that is not.")] = 7,
    device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
) -> None:
    """Interactions per second of random walks: median, least and greatest of the repeats."""
    surface = surfaces.load(name)
    generator = torch.Generator().manual_seed(0)
    u, square = torch.rand(2, count, 2, generator=generator)
    wi, channel = square_to_disk(square), torch.randint(3, (count,), generator=generator)
    rates = []
    for seed in range(repeats + 1):
        start = time.perf_counter()
        found = surface.walk(u, wi, channel, seed, device)
        rates.append(found.counts.interactions / (time.perf_counter() - start) / 1e6)
    rates = rates[1:]
    typer.echo(
        f"{name}: {statistics.median(rates):.2f} million interactions/s"
        f" ({min(rates):.2f} to {max(rates):.2f}), {found.counts.interactions / count:.2f} a walk"
    )


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; a refused input is one line and status 2."""
    try:
        app(arguments)
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
