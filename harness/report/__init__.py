"""The report: tables, figures and a page, made from stored results and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["make", "print_tables"]


def make(
    results_dir: str | Path, notify: Callable[[str], None] = lambda message: None
) -> list[Path]:
    """Write ``report/`` in a results folder; the files written, the page first.

    ``notify`` is told what is left out and why.
    """
    from harness.report.write import write

    return write(Path(results_dir), notify)


def print_tables(results_dir: str | Path, console: Console) -> None:
    """Print the suite's tables, fitted to the width of ``console``."""
    from harness.report.write import print_all

    print_all(Path(results_dir), console)
