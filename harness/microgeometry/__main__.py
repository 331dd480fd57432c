"""``python -m harness.microgeometry sheet OUT.png`` and ``... speed``: look at it, time it."""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from harness.core.outputs import file_to_write
from harness.core.pictures import MARK, marked
from harness.core.protocol.errors import InputError
from harness.microgeometry import descriptions, preview, queries
from harness.microgeometry.walks.surfaces import reliefs

app = typer.Typer(add_completion=False, help="Pictures and speed of microgeometry.")


@app.command()
def sheet(
    out: Annotated[Path, typer.Argument(help="The PNG to write.")],
    name: Annotated[list[str] | None, typer.Option(help="Descriptions; all by default.")] = None,
    pixels: Annotated[int, typer.Option(help="Side of each picture.")] = 200,
    spp: Annotated[int, typer.Option(help="Paths per pixel and light.")] = 16,
    resolution: Annotated[int, typer.Option(help="Texels along the tile.")] = 512,
    columns: Annotated[int, typer.Option(help="Materials in a row.")] = 2,
    device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
) -> None:
    """A contact sheet: the tile from above, in perspective, and on a sphere."""
    from matplotlib.image import imsave

    file_to_write(out, "OUT", marked, "a picture of this command")
    strips = []
    for item in name or reliefs():
        surface = descriptions.load(item, resolution)
        pictures = [
            preview.plane(surface, pixels, spp=spp, dome=0.4, device=device),
            preview.perspective(surface, pixels, spp=spp, device=device),
            preview.sphere(surface, pixels, spp=spp, tiles=2, device=device),
        ]
        strips.append(np.concatenate([p.cpu().numpy() for p in pictures], 1))
        typer.echo(f"{item}: rms slope {surface.slope:.2f}, depth {surface.depth:.3f}")
    strips += [np.zeros_like(strips[0])] * (-len(strips) % columns)
    rows = [np.concatenate(strips[k : k + columns], 1) for k in range(0, len(strips), columns)]
    imsave(out, preview.srgb(np.concatenate(rows)), metadata=MARK)


@app.command()
def speed(
    name: Annotated[str, typer.Argument(help="A description.")] = "leather",
    count: Annotated[int, typer.Option(help="Paths per repeat.")] = 1 << 20,
    samples: Annotated[int, typer.Option(help="Paths per query.")] = 2,
    depth: Annotated[int, typer.Option(help="Bounces.")] = 3,
    resolution: Annotated[int, typer.Option(help="Texels along the tile.")] = 512,
    repeats: Annotated[int, typer.Option(help="Timed draws, after one that is not.")] = 7,
    device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
) -> None:
    """Random queries per second, end to end: median, least and greatest of the repeats."""
    start = time.perf_counter()
    surface = descriptions.load(name, resolution)
    evaluated = time.perf_counter()
    queries.draw(surface, count // samples, 0, samples=samples, depth=depth, device=device)
    warm = time.perf_counter()
    rates = []
    for seed in range(1, repeats + 1):
        begin = time.perf_counter()
        queries.draw(surface, count // samples, seed, samples=samples, depth=depth, device=device)
        rates.append(count / (time.perf_counter() - begin) / 1e6)
    typer.echo(
        f"{name} on {device}: {statistics.median(rates):.2f} M samples/s"
        f" ({min(rates):.2f} to {max(rates):.2f} in {repeats}); fields {evaluated - start:.1f} s,"
        f" first queries {warm - evaluated:.1f} s"
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
