"""A table of the time of a neural material's two stages."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from harness.materials.neural import files
from harness.measures.stage_times import run
from harness.stats.intervals import median_interval


def table(file: Path, rows: int, rounds: int, device: str = "cpu") -> Table:
    """Medians with 95 % intervals of the stages of the material in ``file``."""
    material = files.make(file.stem, file, {})
    timing = run(material, rows, rounds, device)
    found = Table(
        title=f"{material.name}: {rows:,} directions on {device}",
        caption=f"stage 2 takes {timing.ratio:.2f} times the bare network's time",
    )
    for name in ("", "ms", "95 % interval", "M rows/s"):
        found.add_column(name, justify="right" if name else "left")
    for name, seconds in timing.seconds.items():
        middle, low, high = (1e3 * x for x in median_interval(seconds))
        found.add_row(
            name, f"{middle:.1f}", f"[{low:.1f}, {high:.1f}]", f"{rows / middle / 1e3:.1f}"
        )
    return found
