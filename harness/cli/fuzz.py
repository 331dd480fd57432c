"""``harness fuzz``: hostile input by the thousand, none of which may end in a traceback."""

from __future__ import annotations

import sys
from functools import partial
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def fuzz(
        kind: Annotated[str, typer.Argument(help="suites, stores, checkpoints or scenes.")],
        count: Annotated[int, typer.Option(min=1, help="Inputs to try.")] = 1000,
        seconds: Annotated[float, typer.Option(min=0.1, help="Stop after so long.")] = float("inf"),
        seed: Annotated[int, typer.Option(min=0, help="Of the first; the next has the next.")] = 0,
    ) -> None:
        """Spoil suites, stored results, material or scene files at random, and read them.

        Each has to be taken for what it is or refused in one line, in 10 s and 1 GiB, and no
        table may change in silence. Exit status 1 if one is not; its seed makes it again.
        """
        from harness.core.protocol.errors import InputError, nearest
        from harness.fuzz.run import run
        from harness.fuzz.worker import KINDS

        if kind not in KINDS:
            raise InputError(f"fuzz: cannot spoil '{kind}'{nearest(kind, KINDS)}")
        say = partial(print, file=sys.stderr, flush=True)
        found = run(kind, count, seconds, seed, say)
        for number, text in found.wrong.items():
            print(f"seed {number} (harness fuzz {kind} --count 1 --seed {number}):\n{text}")
        total = found.counts.total()
        parts = [f"{found.counts[key]} {key}" for key in ("accepted", "refused", "wrong")]
        print(
            f"{total} {kind}: {', '.join(parts)}; the slowest took {found.slowest:.1f} s;"
            f" {len(found.lines)} kinds of refusals"
        )
        raise typer.Exit(1 if found.wrong else 0)
