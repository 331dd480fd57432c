"""A finished trial on its way into the store: its files, then the rest in one transaction."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from harness.core.protocol.errors import InputError
from harness.store import files
from harness.store.folder import ResultsFolder
from harness.store.stored import STATE, Stored

if TYPE_CHECKING:
    import numpy as np
    import torch

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def save(results: ResultsFolder, trial: Stored, outcome: Any) -> Stored:
    """Store a trial with the raw outputs and records of its ``outcome``.

    ``outcome`` has the attributes of :class:`harness.measures.base.Outcome`: ``images`` [H, W, 3]
    are linear and kept as EXR in half precision; ``tensors`` are the state of a fitted method,
    None where there is none.

    Raises:
        ValueError, TypeError, RuntimeError: something in it cannot be stored.
        InputError: the folder cannot be written.
    """
    kept = {}
    try:
        for name, image in outcome.images.items():
            if not _NAME.fullmatch(name):
                raise ValueError(f"not a name for an image: {name!r}")
            kept[f"{name}.exr"] = files.keep(results.folder, f"{name}.exr", _image(image))
        if outcome.tensors is not None:
            kept[STATE] = files.keep(results.folder, STATE, _tensors(outcome.tensors))
    except OSError as error:
        raise InputError(f"{results.folder}: cannot be written: {error.strerror}") from error
    whole = replace(
        trial,
        records=[_record(record) for record in outcome.records],
        documents=dict(outcome.documents),
        traceback=outcome.traceback,
        state=kept.get(STATE, ""),
    )
    return results.save(whole, outcome.arrays, kept)


def _record(record: Any) -> dict[str, Any]:
    return {
        "metric": record.metric,
        "value": float(record.value),
        "ci_low": float(record.ci_low),
        "ci_high": float(record.ci_high),
        "unit": record.unit,
    }


def _image(image: np.ndarray) -> bytes:
    from harness.mitsuba_runtime import exr

    return exr.encoded(image)


def _tensors(tensors: Mapping[str, torch.Tensor]) -> bytes:
    from safetensors.torch import save

    # The format wants memory that is contiguous and not shared between tensors.
    plain = {key: t.detach().cpu().contiguous().clone() for key, t in tensors.items()}
    return save(plain)
