"""The report: tables, figures and a page, made from stored results and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from harness.report.write import Report

__all__ = ["load"]


def load(results_dir: str | Path) -> Report:
    """The report of a results folder, to be written or printed."""
    from harness.report.write import Report

    return Report.of(Path(results_dir))
