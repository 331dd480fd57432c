"""Fitted samplers that come with the harness: a run measures with them instead of fitting.

One file per fit, ``harness/fitted/MATERIAL--METHOD--KEY.safetensors``: the state, and in the
metadata what the fit was (:func:`described`) and its record: seconds, machine, versions, loss.
A trial that is answered from here keeps the stored record, with the machine and the time of
day it was taken at, and says so under ``shipped``. ``checksums.txt`` beside them has the SHA-256 of
each (``sha256sum --check`` reads it); a file that is not what was stored answers no fit, which is
then run.
"""

from __future__ import annotations

import hashlib
import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

from harness.analysis.records.fit import raw_of
from harness.core.paths import ROOT
from harness.core.protocol.errors import InputError
from harness.identity.verdict import ADAPTER, MATERIAL, MEASURE, TRAINING, VERSIONS
from harness.measures.base import Outcome
from harness.store import files
from harness.store.stored import Stored
from harness.suite.trials import FIT, Trial, hash_of

FOLDER = ROOT / "harness" / "fitted"
FORMAT = "fitted-sampler 2"
KEPT_PARTS = (ADAPTER, TRAINING, MATERIAL, MEASURE, VERSIONS)
"""Digests that are kept with a state: what it was fitted with."""
CHECKSUMS = "checksums.txt"
_STATE, _ARRAY = "state.", "array."


def described(trial: Trial) -> dict[str, Any]:
    """What makes a fit the same fit, wherever and whenever it is run.

    Material, method, parameters, budget and seed. Not the device, machine or versions, which the
    record names, nor the code: a state is data, and what it gives is measured anew. The digests
    of the code that fitted it are kept beside it; where that has changed, its seconds and its loss
    are those of an earlier version, which ``harness status`` and captions say.
    """
    method = trial.identity["method"]
    budget = {key: value for key, value in method["budget"].items() if key != "device"}
    return {
        "material": trial.identity["material"],
        "method": {"name": method["name"], "params": method["params"], "budget": budget},
        "seed": trial.seed,
    }


def key(trial: Trial) -> str:
    """The hash that a stored fit is found by."""
    return hash_of(described(trial))


def find(trial: Trial, folder: Path = FOLDER) -> Path | None:
    """The file that answers a fit, if there is one that is what was stored."""
    path = _index(folder).get(key(trial)) if trial.measure == FIT else None
    return None if path is None or _damaged(path) else path


def damaged(trial: Trial, folder: Path = FOLDER) -> str:
    """Why the file that would answer a fit is not taken; "" if it is, or there is none."""
    path = _index(folder).get(key(trial)) if trial.measure == FIT else None
    if path is None or not _damaged(path):
        return ""
    return f"{path}: does not match its checksum; fitted again instead"


def load(path: Path) -> tuple[Outcome, dict[str, Any]]:
    """A stored fit as its outcome, and its ``environment``, ``started`` and ``seconds``.

    Raises:
        InputError: the file is damaged.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        if metadata.get("format") != FORMAT:
            raise ValueError(f"format is {metadata.get('format')!r}")
        about = json.loads(metadata["record"])
        values = {record["metric"]: record["value"] for record in about.pop("records")}
        about["started"], about["seconds"], about["environment"], about["parts"]
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: not a fitted sampler: {error}; --refit does without") from None
    arrays = {n.removeprefix(_ARRAY): t.numpy() for n, t in tensors.items() if n.startswith(_ARRAY)}
    state = {n.removeprefix(_STATE): t for n, t in tensors.items() if n.startswith(_STATE)}
    return Outcome(arrays={**raw_of(values), **arrays}, tensors=state), about


def save(trial: Trial, stored: Stored, folder: Path = FOLDER) -> Path | None:
    """Keep a fit that was run; None for one with nothing to keep (no state, or not ``ok``).

    An older file of the same material and method is left: it answers another budget or seed.
    """
    from safetensors.torch import save as packed

    if stored.status != "ok" or not stored.has_state:
        return None
    state = stored.tensors()
    if not state:
        return None
    import torch

    tensors = {f"{_STATE}{name}": tensor.contiguous() for name, tensor in state.items()}
    for name, array in stored.arrays.items():
        tensors[f"{_ARRAY}{name}"] = torch.from_numpy(array).contiguous()
    about = {
        "records": stored.records,
        "environment": stored.environment,
        "started": stored.started,
        "seconds": stored.seconds,
        "parts": {part: stored.parts[part] for part in KEPT_PARTS if part in stored.parts},
    }
    metadata = {
        "format": FORMAT,
        "fit": json.dumps(described(trial), sort_keys=True),
        "record": json.dumps(about, sort_keys=True),
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name_of(trial)
    content = packed(tensors, metadata)
    files.put(path, content)
    known = _checksums(folder) | {path.name: hashlib.sha256(content).hexdigest()}
    lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(known.items()))
    files.put(folder / CHECKSUMS, lines.encode())
    for cache in (_index, _checksums, _damaged):
        cache.cache_clear()
    return path


def seconds(method: str, folder: Path = FOLDER) -> list[float]:
    """How long the fits of the method with this label took that are kept, wherever they ran."""
    from safetensors import SafetensorError, safe_open

    found = []
    for path in _index(folder).values():
        if path.name.split("--")[1:-1] == [_plain(method)]:
            try:
                with safe_open(path, framework="numpy") as file:
                    found.append(float(json.loads((file.metadata() or {})["record"])["seconds"]))
            except (OSError, SafetensorError, ValueError, KeyError, TypeError, RecursionError):
                continue  # whoever takes it as a fit will say so
    return [value for value in found if 0 < value < math.inf]


def name_of(trial: Trial) -> str:
    """The name of the file that keeps a fit."""
    return f"{trial.material}--{_plain(trial.method)}--{key(trial)}.safetensors"


def is_folder_of_fits(folder: Path) -> bool:
    """Whether all that a folder holds are fitted samplers; some are there, or their checksums."""
    names = {path.name for path in folder.iterdir()}
    return CHECKSUMS in names or all(is_fit(folder / name) for name in names)


def is_fit(path: Path) -> bool:
    """Whether a file is a fitted sampler, as far as its description tells."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            return (file.metadata() or {}).get("format") == FORMAT
    except (OSError, SafetensorError):
        return False


@lru_cache(maxsize=8)
def _index(folder: Path) -> dict[str, Path]:
    return {path.stem.rpartition("--")[2]: path for path in sorted(folder.glob("*.safetensors"))}


@lru_cache(maxsize=8)
def _checksums(folder: Path) -> dict[str, str]:
    """SHA-256 by name; nothing is known of a file that is not named."""
    try:
        lines = (folder / CHECKSUMS).read_text("utf-8", "replace").splitlines()
    except OSError:
        return {}
    pairs = (line.partition("  ") for line in lines)
    return {name: digest for digest, gap, name in pairs if gap}


@lru_cache(maxsize=4096)
def _damaged(path: Path) -> bool:
    wanted = _checksums(path.parent).get(path.name)
    return wanted is not None and hashlib.sha256(path.read_bytes()).hexdigest() != wanted


def _plain(label: str) -> str:
    """A method's label as part of a file name."""
    return "".join(c if c.isalnum() or c in "-." else "_" for c in label).strip("_")
