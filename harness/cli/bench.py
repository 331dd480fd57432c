"""``harness bench``: how fast each adapter is, alone and in a render."""

from __future__ import annotations

from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def bench(
        methods: Annotated[
            list[str] | None, typer.Argument(help="Methods to time; all of them by default.")
        ] = None,
        material: Annotated[str, typer.Option(help="Material to sample.")] = "hull-panel",
        scene: Annotated[str, typer.Option(help="Scene to render.")] = "uniform-sphere",
        device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
        rounds: Annotated[int, typer.Option(help="Interleaved rounds.")] = 11,
        steps: Annotated[int, typer.Option(help="Fitting steps before timing.")] = 60,
        effects: Annotated[
            bool, typer.Option("--effects", help="Scenes of one effect beside Mitsuba by hand.")
        ] = False,
        profile: Annotated[
            bool, typer.Option("--profile", help="Where a sample's nanoseconds go, on the CPU.")
        ] = False,
        ratios: Annotated[
            bool,
            typer.Option(
                "--ratios", help="Compiled kernels beside Dr.Jit and PyTorch, on the CPU."
            ),
        ] = False,
    ) -> None:
        """Time samples, pdf queries and renders, beside Mitsuba's own path tracer."""
        from rich.table import Table

        from harness.bench import effect_overhead
        from harness.bench import profile as profiling
        from harness.bench import ratios as beside
        from harness.bench.adapters import run
        from harness.core.protocol.errors import InputError, Unsupported
        from harness.core.terminal import Screen

        for wanted, option in ((profile, "--profile"), (ratios, "--ratios")):
            if wanted and device != "cpu":
                raise InputError(f"bench {option}: device is '{device}'; expected cpu")
        console = Screen()
        with console.status("preparing") as status:
            if effects:
                rows = effect_overhead.run(device, rounds, status.update)
            elif ratios:
                rows = beside.run(methods, material, rounds, steps, status.update)
            elif profile:
                rows = profiling.run(methods, material, rounds, steps, status.update)
            else:
                try:
                    rows = run(methods, material, scene, device, rounds, steps, status.update)
                except Unsupported as error:
                    raise InputError(
                        f"bench --material: {error}; renders are timed beside one's own sampler"
                    ) from None
        table = Table(title=rows.title, caption=rows.caption)
        for i, name in enumerate(rows.columns):
            table.add_column(name, justify="left" if i == 0 else "right")
        for row in rows.cells:
            table.add_row(*row)
        console.print(table)
