"""Runs a measure as the runner does: raw data, stored and read again, then records."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from harness.analysis.records import registry as records
from harness.core.record import Raw
from harness.measures import registry as measures
from harness.measures.base import Job, Outcome
from harness.store.packing import array_bytes, array_of, json_bytes


def run(
    name: str, jobs: Sequence[Job], notify: Callable[[str], None] = lambda text: None
) -> list[Outcome]:
    """Outcomes of the measure ``name``, with the records that the analysis makes of them."""
    outcomes = measures.make(name).run(list(jobs), notify)
    for job, outcome in zip(jobs, outcomes, strict=True):
        numbered(name, outcome, job.settings)
    return outcomes


def numbered(name: str, outcome: Outcome, settings: dict[str, Any]) -> Outcome:
    """``outcome`` with its records, made of what a store would give back of it."""
    assert not outcome.records
    if outcome.status == "ok":
        raw = Raw(*_stored(outcome.arrays, outcome.documents), settings)
        found = records.numbers(name, raw)
        assert found is not None
        outcome.records, outcome.reason = found.records, found.reason
    return outcome


def _stored(
    arrays: dict[str, np.ndarray], documents: dict[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Both, written and read."""
    read = {name: array_of(array_bytes(array)) for name, array in arrays.items()}
    for name, array in arrays.items():
        assert (read[name].shape, read[name].dtype) == (np.shape(array), array.dtype)
    return read, json.loads(json_bytes(documents))
