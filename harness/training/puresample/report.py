"""A table of how materials learned from walks came to be and how well they answer."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from harness.materials.puresample import storage

COLUMNS = ("material", "form", "KL (nats)", "±", "worst KL", "no density",
           "albedo within 3 %", "albedo off by",
           "mean albedo", "walks' noise", "walks", "trace", "train", "seed", "kB")  # fmt: skip


def table(files: list[Path]) -> Table:
    """One row a file, a column where there is only one.

    ``no density``: share of directions at which a step is not one to one, and f is not a number.
    ``albedo off by`` and the noise of the walks are 95th percentiles over directions and channels.
    """
    found = Table(
        title="Materials learned from walks", caption="errors beside walks held out from training"
    )
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
    quality, profile = record.get("quality", {}), record.get("profile", {})
    shape = profile.get("architecture", {})

    def number(source: dict, key: str, pattern: str) -> str:
        return pattern.format(source[key]) if key in source else "†"

    form = "{} x {}, {} steps".format(*(shape.get(k, "†") for k in ("layers", "width", "steps")))
    if shape.get("channels"):
        form += f", texture {shape['resolution']}² x {shape['channels']}"
    return [
        str(record.get("name", file.stem)),
        form,
        number(quality, "kl", "{:.4f}"),
        number(quality, "kl_error", "{:.4f}"),
        number(quality, "kl_worst", "{:.3f}"),
        number(quality, "lost", "{:.2%}"),
        number(quality, "albedo_within", "{:.0%}"),
        number(quality, "albedo_error", "{:.1%}"),
        number(quality, "albedo_bias", "{:+.2%}"),
        number(quality, "albedo_noise", "{:.1%}"),
        number(profile, "walks", "{:,}"),
        number(record, "data_seconds", "{:.0f} s"),
        number(record, "train_seconds", "{:.0f} s"),
        number(record, "seed", "{}"),
        f"{file.stat().st_size / 1000:.0f}",
    ]
