"""Times of several pieces of work in interleaved rounds."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import drjit as dr
import numpy as np
import torch

from harness.measures.timing import round_order

Work = Callable[[], object]


def interleaved(
    works: Mapping[str, Work], rounds: int, device: str = "cpu"
) -> dict[str, np.ndarray]:
    """Seconds [rounds] of each, after two rounds that compile and allocate.

    On a CPU the processor's clock, which other work on the machine lengthens less than the wall's.
    """
    times: dict[str, list[float]] = {name: [] for name in works}
    names = list(works)
    for number in range(rounds + 2):
        for place in round_order(len(names), number):
            name = names[place]
            start = _clock(device)
            works[name]()
            times[name].append(_clock(device) - start)
    return {name: np.array(values[2:]) for name, values in times.items()}


def _clock(device: str) -> float:
    dr.sync_thread()
    if device == "cpu":
        return time.process_time()
    torch.cuda.synchronize()
    return time.perf_counter()
