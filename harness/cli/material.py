"""``harness material``: train a neural material, measure it, look at it, time it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

INTERRUPTED = 130


def register(app: typer.Typer) -> None:
    """Add the verb and its own verbs to ``app``."""
    material = typer.Typer(help="Train, measure, preview, show and time neural materials.")
    app.add_typer(material, name="material", no_args_is_help=True)

    @material.command()
    def train(
        description: Annotated[str, typer.Argument(help="Microgeometry: a .yaml file or a name.")],
        out: Annotated[Path, typer.Option(help="File to write: NAME.safetensors.")],
        kind: Annotated[
            str, typer.Option(help="neural (from evaluations) or puresample (from walks).")
        ] = "neural",
        profile: Annotated[
            str,
            typer.Option(
                help="quick, relief, deep or full; quick- or full-pyramid. Of puresample: quick,"
                " fine, full; quick- or full-texture."
            ),
        ] = "quick",
        set_: Annotated[
            list[str] | None,
            typer.Option(
                "--set",
                help="A size of the network or of the training: offset=false, steps=9000, ...",
            ),
        ] = None,
        seed: Annotated[int, typer.Option(help="Of the weights, the queries and the batches.")] = 0,
        resume: Annotated[bool, typer.Option("--resume", help="Go on from OUT's .train.")] = False,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Trace queries or walks of a surface, fit networks to them, store them with a record."""
        from rich.progress import Progress

        from harness.core.outputs import file_to_write
        from harness.core.terminal import Screen
        from harness.training import kinds

        kinds.check(kind, description)
        _ready(device)
        if out.suffix == ".safetensors":  # else the recipe says what it has to be
            file_to_write(out, "--out", _is_ours, "a material of harness material train")
            under_way = out.with_suffix(".train")
            file_to_write(under_way, "--out: beside it", _is_training, "a training under way")
        console = Screen()
        with Progress(console=console) as progress:
            task = progress.add_task("", total=1.0)

            def notify(text: str, share: float) -> None:
                progress.update(task, description=text, completed=share)

            try:
                kinds.train(
                    kind, description, out, profile, seed, device, resume, notify, set_ or ()
                )
            except KeyboardInterrupt:
                progress.stop()
                console.print(kinds.interrupted(out))
                raise typer.Exit(INTERRUPTED) from None
        _show(console, [out])

    @material.command()
    def detail(
        names: Annotated[list[str], typer.Argument(help="Microgeometries: .yaml files or names.")],
        resolution: Annotated[int, typer.Option(help="Texels a side of the texture.")] = 128,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Print where a surface is too fine for a texture, before any training."""
        from harness.core.terminal import Screen
        from harness.microgeometry import descriptions
        from harness.training import report

        _ready(device)
        surfaces = [descriptions.load(name) for name in names]
        Screen().print(report.detail(surfaces, resolution, device))

    @material.command()
    def show(
        names: Annotated[
            list[str] | None, typer.Argument(help="Materials or files; all shipped by default.")
        ] = None,
    ) -> None:
        """Print how materials were trained and how well they answer."""
        from harness.core.terminal import Screen
        from harness.training import kinds

        known = list(kinds.shipped().values())
        _show(Screen(), [_file(name) for name in names] if names else known)

    @material.command()
    def measure(
        name: Annotated[str, typer.Argument(help="A shipped material, or a file.")],
        seed: Annotated[int, typer.Option(help="Of the held-out queries.")] = 0,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Measure a material's errors again and rewrite its record; its tensors stay."""
        from harness.core.terminal import Screen
        from harness.training import kinds

        _ready(device)
        file = _file(name)
        kinds.measure(file, seed, device)
        _show(Screen(), [file])

    @material.command()
    def refine(
        name: Annotated[str, typer.Argument(help="A shipped material, or a file.")],
        steps: Annotated[int, typer.Option(min=1, help="Of Adam.")] = 800,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Teach a stored material energies, as a training's end does; rewrites its file."""
        from rich.progress import Progress

        from harness.core.terminal import Screen
        from harness.training import recipe

        _ready(device)
        file, console = _file(name), Screen()
        with Progress(console=console) as progress:
            task = progress.add_task("", total=1.0)
            recipe.refine(
                file,
                steps,
                device,
                lambda text, share: progress.update(task, description=text, completed=share),
            )
        _show(console, [file])

    @material.command()
    def preview(
        name: Annotated[str, typer.Argument(help="A shipped material, or a file.")],
        description: Annotated[
            str | None, typer.Option(help="Its microgeometry; by default the one of its record.")
        ] = None,
        out: Annotated[Path | None, typer.Option(help="PNG; by default NAME-preview.png.")] = None,
        size: Annotated[int, typer.Option(help="Pixels a side of each picture.")] = 256,
        spp: Annotated[int, typer.Option(help="Paths per pixel of the truth.")] = 32,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Draw sphere, plane and slices of a material beside the path-traced truth."""
        from harness.core.terminal import Screen
        from harness.training import kinds

        _ready(device)
        file = _file(name)
        written = kinds.preview(file, description, _png(out, file), size, spp, device)
        Screen(highlight=False).print(f"{written}", soft_wrap=True)

    @material.command()
    def bench(
        name: Annotated[str, typer.Argument(help="A shipped material, or a file.")],
        rows: Annotated[int, typer.Option(help="Directions.")] = 1 << 20,
        rounds: Annotated[int, typer.Option(help="Interleaved rounds.")] = 11,
        device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    ) -> None:
        """Time both stages beside a bare torch network of the decoder's size, in one run."""
        from harness.bench import neural, puresample
        from harness.core.terminal import Screen
        from harness.materials.puresample.files import is_one

        _ready(device)
        file = _file(name)
        timing = puresample if is_one(file) else neural
        Screen().print(timing.table(file, rows, rounds, device))


def _png(out: Path | None, file: Path) -> Path:
    """Where the picture goes; a folder gets NAME-preview.png. Asked before anything is traced."""
    from harness.core.outputs import file_to_write
    from harness.core.pictures import marked
    from harness.core.protocol.errors import InputError

    if out == Path():
        raise InputError("--out: expected a name that ends in .png, or a folder")
    if out is None or out.is_dir():
        out = (out or Path()) / f"{file.stem}-preview.png"
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}: expected a name that ends in .png, or a folder")
    return file_to_write(out, "--out", marked, "a picture of this command")


def _is_ours(path: Path) -> bool:
    from harness.materials.neural import storage
    from harness.materials.puresample.files import is_one

    return is_one(path) or bool(storage.metadata(path))  # refuses what is not in our format


def _is_training(path: Path) -> bool:
    import zipfile

    with zipfile.ZipFile(path) as archive:
        return any(name.endswith("/data.pkl") for name in archive.namelist())


def _ready(device: str) -> None:
    from harness.runner import preflight

    preflight.ready(device)


def _file(name: str) -> Path:
    """A shipped material's file, or the file itself."""
    from harness.training import kinds

    return kinds.file_of(name)


def _show(console, files: list[Path]) -> None:
    from harness.training import kinds

    for table in kinds.tables(files):
        console.print(table)
