"""Tables: how stored materials came to be and how well they answer; what is too fine for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.table import Table

from harness.core.protocol.errors import InputError
from harness.materials.neural import storage
from harness.training import detail as texture_detail

COLUMNS = ("material", "form", "R² of log(1+f)", "±", "energy off by", "within 5 %", "mean energy",
           "truth's noise", "trace", "train", "steps", "seed", "kB")  # fmt: skip


def table(files: list[Path]) -> Table:
    """One row a file, a column where there is only one.

    ``energy off by`` is the 95th percentile over conditions.

    Raises:
        InputError: a published checkpoint, which has no record.
    """
    for file in files:
        if file.suffix != ".safetensors":
            raise InputError(f"{file}: a published checkpoint has no training record")
    found = Table(title="Neural materials", caption="errors on queries held out from training")
    rows = [cells(file) for file in files]
    if len(rows) == 1:
        found.add_column(COLUMNS[0])
        found.add_column(rows[0][0], justify="right")
        for name, cell in zip(COLUMNS[1:], rows[0][1:], strict=True):
            found.add_row(name, cell)
        return found
    for i, name in enumerate(COLUMNS):
        found.add_column(name, justify="left" if i < 2 else "right")
    for row in rows:
        found.add_row(*row)
    return found


def cells(file: Path) -> list[str]:
    """The row of one file, a dagger where its record says nothing."""
    record = storage.record(file)
    quality = record.get("quality", {})

    def number(source: dict, key: str, pattern: str) -> str:
        return pattern.format(source[key]) if key in source else "†"

    shape = record.get("profile", {}).get("architecture", {})
    form = "pyramid" if shape.get("pyramid") else "one resolution"
    return [
        str(record.get("name", file.stem)),
        form + (", offset" if shape.get("offset", True) else ""),
        number(quality, "r2", "{:.3f}"),
        number(quality, "r2_error", "{:.3f}"),
        number(quality, "energy_error", "{:.1%}"),
        number(quality, "energy_within", "{:.0%}"),
        number(quality, "energy_bias", "{:+.1%}"),
        number(quality, "energy_noise", "{:.1%}"),
        number(record, "data_seconds", "{:.0f} s"),
        number(record, "train_seconds", "{:.0f} s"),
        number(record, "steps", "{}"),
        number(record, "seed", "{}"),
        f"{file.stat().st_size / 1000:.0f}",
    ]


def detail(surfaces: list[Any], resolution: int, device: str = "cpu") -> Table:
    """A row a surface: where a texture of ``resolution``^2 misses more than 5 % of the energy."""
    found = Table(
        title=f"Too fine for {resolution}² texels",
        caption="places where the mean of four texels is off by over 5 % between them",
    )
    found.add_column("surface")
    for cosine in texture_detail.COSINES:
        found.add_column(f"camera at cosine {cosine:g}", justify="right")
    found.add_column("noise", justify="right")
    for surface in surfaces:
        seen = texture_detail.measure(surface, resolution, device=device)
        noise = max(one.noise for one in seen)
        found.add_row(surface.name, *(f"{one.share:.1%}" for one in seen), f"{noise:.1%}")
    return found
