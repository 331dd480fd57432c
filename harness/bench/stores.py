"""``python -m harness.bench.stores``: how long a large store takes to load and to report.

The store is made up (:mod:`harness.fuzz.synthetic`): trials with two numbers, two arrays, a
document and a state each. Processor seconds are of this process alone: they do not count what
else the machine does.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from harness.analysis.results import Results
from harness.fuzz import synthetic
from harness.report.write import Report

T = TypeVar("T")
_A_MATERIAL = 2 * len(synthetic.METHODS)
"""Trials of one seed: a fit and a measure of each method."""


def run(trials: int, seeds: int = 10) -> dict[str, float]:
    """Processor seconds to make, load, tabulate and report about so many trials."""
    with tempfile.TemporaryDirectory(prefix="harness-bench-") as folder:
        count = max(1, trials // (_A_MATERIAL * seeds))
        where, made = _timed(lambda: synthetic.make(Path(folder) / "store", count, seeds))
        results, loaded = _timed(lambda: Results.load(where))
        report, tables = _timed(lambda: Report.of(results))
        _, written = _timed(report.write)
    return {
        "trials": len(results.plan["trials"]),
        "made": made,
        "loaded": loaded,
        "tabulated": tables,
        "written": written,
    }


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    begun = time.process_time()
    return work(), time.process_time() - begun


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=10_000)
    found = run(parser.parse_args().trials)
    count = int(found.pop("trials"))
    said = ", ".join(f"{what} in {seconds:.1f} s" for what, seconds in found.items())
    print(f"{count} trials: {said}")


if __name__ == "__main__":
    main()
