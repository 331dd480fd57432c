"""A trial as it is stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from harness.core.protocol.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import torch

COLUMNS = (
    "suite material method scene measure metric value ci_low ci_high unit seed status reason trial"
).split()
LABELS = ("suite", "material", "method", "scene", "measure", "seed")
NOT_RUN = "not run yet"
DAMAGED = "damaged"
"""Status of a trial that is not what was stored; in the results' frame it is an ``error``."""
STATE = "state.safetensors"
"""Name of the file with a fitted method's state; all other files are images."""


@dataclass
class Stored:
    """A trial as stored. Arrays, images and tensors are read when asked for.

    ``trial`` is its description, which the key is the hash of; ``records`` are dicts of metric,
    value, ci_low, ci_high, unit; ``environment`` says which machine and versions; ``parts`` are the
    digests of the code and data that it was measured with (:mod:`harness.identity`).
    """

    hash: str
    trial: dict[str, Any]
    labels: dict[str, Any]
    status: str
    reason: str
    records: list[dict[str, Any]] = field(default_factory=list)
    environment: dict[str, Any] = field(default_factory=dict)
    started: str = ""
    seconds: float = 0.0
    traceback: str = ""
    folder: Path | None = None
    fit: str = ""
    """Key of the fit that was measured; "" for a fit."""
    shipped: str = ""
    """Of a fit that was not run but came with the harness: the name of its file."""
    effects: dict[str, Any] = field(default_factory=dict)
    """What ``effects: auto`` came to in the trial's scene, and why; empty without ``auto``."""
    documents: dict[str, Any] = field(default_factory=dict)
    """Raw outputs that are no arrays, by name: plain data."""
    parts: dict[str, str] = field(default_factory=dict)
    entries: dict[str, Any] = field(default_factory=dict)
    """By part that is source code: where that code begins, as ``module:name``."""
    analysis: str = ""
    """Digest of the analysis that made the records of the raw outputs; "" if it cannot again."""
    state: str = ""
    """Digest of the fitted method's state, which published results name without keeping it."""
    findings: list[str] = field(default_factory=list)
    """What the method was seen to change that is not its own, such as torch's default type."""
    kept_arrays: dict[str, str] = field(default_factory=dict)
    """Digests of the raw arrays, by name."""
    files: dict[str, str] = field(default_factory=dict)
    """Digests of the files beside the database, by name."""
    reader: Callable[[str, dict[str, str]], dict[str, np.ndarray]] | None = field(
        default=None, repr=False
    )
    """Reads raw arrays, given the key and their digests by name; None where there are none."""

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """Raw outputs by name."""
        return self.reader(self.hash, self.kept_arrays) if self.reader is not None else {}

    @cached_property
    def images(self) -> dict[str, np.ndarray]:
        """Images [H, W, 3] by name, linear."""
        from harness.mitsuba_runtime import exr
        from harness.store.files import checked

        found = {}
        for name in sorted(name for name in self.files if name != STATE):
            path = checked(self._folder, name, self.files[name])
            try:
                found[name.removesuffix(".exr")] = exr.read(path)
            except RuntimeError as error:
                raise InputError(f"{path}: is no picture: {error}") from None
        return found

    def tensors(self, device: str = "cpu") -> dict[str, torch.Tensor]:
        """State of the fitted method."""
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        from harness.store.files import checked

        if not self.has_state:
            raise InputError(f"{self.folder}: {self.hash} holds no state of a fitted method")
        path = checked(self._folder, STATE, self.files[STATE])
        try:
            return load_file(path, device=device)
        except SafetensorError as error:
            raise InputError(f"{path}: is no state of a fitted method: {error}") from None

    @property
    def has_state(self) -> bool:
        """Whether the state of a fitted method is there."""
        return STATE in self.files

    @property
    def _folder(self) -> Path:
        if self.folder is None:
            raise InputError(f"{self.hash}: not stored yet")
        return self.folder
