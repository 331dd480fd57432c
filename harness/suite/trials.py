"""A trial: one cell of materials x methods x scenes x measures, and the hash of it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from typing import Any

from harness.core.protocol.errors import InputError
from harness.core.protocol.method import Budget

FIT = "fit"
"""Name of the measure that fits a method; all others need its result."""

# A limit that was not reached has no influence on the numbers, and raising it to cure one
# timeout must not throw all other results away.
UNCOUNTED_BUDGET = ("max_seconds",)


@dataclass(frozen=True)
class Trial:
    """One planned trial.

    ``identity`` describes what is asked: material, method and scene with the content of the files
    that they name, measure, settings, seed, and the machine where the number is a time; ``hash``
    is its key. The code that answers is no part of it (:mod:`harness.suite.source_parts`). The
    rest is what the runner needs to carry it out and what tables call it.
    """

    hash: str
    identity: dict[str, Any] = field(repr=False)
    suite: str
    material: str
    method: str
    scene: str
    measure: str
    seed: int
    settings: dict[str, Any] = field(default_factory=dict, repr=False)
    method_name: str = field(default="", repr=False)
    params: dict[str, Any] = field(default_factory=dict, repr=False)
    budget: Budget = field(default_factory=Budget, repr=False)
    material_spec: Any = field(default=None, repr=False)
    scene_spec: Any = field(default=None, repr=False)
    fit: str = ""
    """Hash of the fit that this trial needs, ``""`` for a fit."""
    timed: bool = False

    @property
    def labels(self) -> dict[str, Any]:
        """The trial's place in tables, in the order of the columns of the results."""
        keys = ("suite", "material", "method", "scene", "measure", "seed")
        return {key: getattr(self, key) for key in keys}

    def __str__(self) -> str:
        parts = [self.measure, self.method, self.material, self.scene, f"seed {self.seed}"]
        return " · ".join(part for part in parts if part)


def hash_of(identity: dict[str, Any]) -> str:
    """First 16 hex digits of the SHA-256 of the canonical JSON of ``identity``."""
    return hashlib.sha256(canonical(identity).encode()).hexdigest()[:16]


def canonical(data: Any) -> str:
    """JSON with sorted keys; equal numbers give equal text (``1`` and ``1.0``)."""
    try:
        return json.dumps(_plain(data), sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"expected plain numbers, text, lists and mappings: {error}") from None


def stream_seed(measure: str, seed: int) -> int:
    """Seed of a trial's generator: the same for all methods, another for every measure."""
    return int.from_bytes(hashlib.sha256(f"{measure}/{seed}".encode()).digest()[:7], "big")


def counted_budget(budget: Budget) -> dict[str, Any]:
    """The part of a budget that can change the numbers."""
    return {
        key: value
        for key, value in vars(budget).items()
        if key not in UNCOUNTED_BUDGET and value is not None
    }


def _plain(data: Any) -> Any:
    if isinstance(data, dict):
        return {str(key): _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float) and data.is_integer():
        return int(data)
    return data
