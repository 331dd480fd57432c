"""Numbers of a trial, and the raw data that they are made of."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Record:
    """One measured number, its unit and its interval (nan bounds where there is none)."""

    metric: str
    value: float
    ci_low: float = math.nan
    ci_high: float = math.nan
    unit: str = ""


@dataclass(frozen=True)
class Numbers:
    """What the analysis of a trial's raw data gives.

    ``reason`` is what a reader of the records has to know, such as an interval that stayed wide.
    """

    records: list[Record]
    reason: str = ""


@dataclass(frozen=True)
class Raw:
    """What a measure stored: arrays by name, JSON documents by name, and the trial's settings.

    Those of a timing that was repeated in fresh processes have the prefix ``p0/``, ``p1/``, ...
    (:mod:`harness.analysis.process_pooling`).
    """

    arrays: Mapping[str, NDArray]
    documents: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)

    def value(self, name: str) -> float:
        """The array ``name``, which holds a single number."""
        return float(np.asarray(self.arrays[name]).item())

    def floats(self, name: str) -> NDArray:
        """The array ``name`` in double precision."""
        return np.asarray(self.arrays[name], float)
