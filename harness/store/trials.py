"""The results store: ``results/<suite>/``, a folder per trial, named by its hash.

    suite.yaml  plan.json                        the suite as run, and the trials it stands for
    <hash>/trial.json  arrays.npz  images/*.exr  state.safetensors
    report/

A trial's folder appears whole or not at all: it is written beside its place and renamed.
This module reads and writes; it measures nothing.
"""

from __future__ import annotations

import fcntl
import math
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from harness.core.jsonfile import dumps, read_json, write_json, write_text
from harness.core.protocol.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    import torch

COLUMNS = (
    "suite material method scene measure metric value ci_low ci_high unit seed status reason trial"
).split()
LABELS = ("suite", "material", "method", "scene", "measure", "seed")
NOT_RUN = "not run yet"
_HASH = re.compile(r"[0-9a-f]{16}")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


@dataclass
class Stored:
    """A trial as stored. Arrays, images and tensors are read when asked for.

    ``trial`` is its identity, the description that the hash covers; ``records`` are dicts of
    metric, value, ci_low, ci_high, unit; ``environment`` says which machine and versions.
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
    shipped: str = ""
    """Of a fit that was not run but came with the harness: the name of its file."""
    effects: dict[str, Any] = field(default_factory=dict)
    """What ``effects: auto`` came to in the trial's scene, and why; empty without ``auto``."""

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """Raw outputs by name."""
        import numpy as np

        if self.folder is None or not (self.folder / "arrays.npz").is_file():
            return {}
        with np.load(self.folder / "arrays.npz", allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    @cached_property
    def images(self) -> dict[str, np.ndarray]:
        """Images [H, W, 3] by name, linear."""
        from harness.mitsuba_runtime import exr

        files = sorted((self.folder / "images").glob("*.exr")) if self.folder else []
        return {file.stem: exr.read(file) for file in files}

    def tensors(self, device: str = "cpu") -> dict[str, torch.Tensor]:
        """State of the fitted method."""
        from safetensors.torch import load_file

        if not self.has_state:
            raise InputError(f"{self.folder}: holds no state of a fitted method")
        assert self.folder is not None  # has_state says so
        return load_file(self.folder / "state.safetensors", device=device)

    @cached_property
    def documents(self) -> dict[str, Any]:
        """Raw outputs that are no arrays, by name."""
        path = self.folder / "documents.json" if self.folder else None
        return read_json(path) if path is not None and path.is_file() else {}

    @property
    def has_state(self) -> bool:
        """Whether the state of a fitted method is there."""
        return self.folder is not None and (self.folder / "state.safetensors").is_file()


# --- writing -----------------------------------------------------------------------------------


def scratch(results: Path, trial: str) -> Path:
    """A new empty folder that :func:`save_trial` turns into the trial's."""
    folder = results / f".tmp-{trial}-{os.getpid()}"
    shutil.rmtree(folder, ignore_errors=True)  # a leftover of an earlier try of this process
    folder.mkdir(parents=True)
    return folder


def discard(results: Path, trial: str) -> None:
    """Remove the folder that :func:`scratch` made."""
    shutil.rmtree(results / f".tmp-{trial}-{os.getpid()}", ignore_errors=True)


def save_trial(results: Path, trial: Mapping[str, Any], outcome: Any) -> Path:
    """Store a trial; an older folder of the same hash is replaced.

    ``trial`` holds ``trial`` (the hash), ``identity``, ``labels``, ``environment``,
    ``started`` and ``seconds``. ``outcome`` has the attributes of
    :class:`harness.measures.base.Outcome`. Files already in the trial's :func:`scratch` folder
    are kept.
    """
    name = trial["trial"]
    if not _HASH.fullmatch(name):
        raise ValueError(f"not a trial's hash: {name!r}")
    folder = results / f".tmp-{name}-{os.getpid()}"
    folder.mkdir(parents=True, exist_ok=True)
    if outcome.arrays:
        import numpy as np

        np.savez_compressed(folder / "arrays.npz", **outcome.arrays)
    if outcome.documents:
        write_json(folder / "documents.json", outcome.documents)
    if outcome.images:
        from harness.mitsuba_runtime import exr

        (folder / "images").mkdir(exist_ok=True)
        for key, image in outcome.images.items():
            if not _NAME.fullmatch(key):
                raise ValueError(f"not a name for an image: {key!r}")
            exr.write(folder / "images" / f"{key}.exr", image)
    if outcome.tensors is not None:
        _save_tensors(folder / "state.safetensors", outcome.tensors)
    described = {
        **trial,
        "status": outcome.status,
        "reason": outcome.reason,
        "records": [_record(record) for record in outcome.records],
        **({"traceback": outcome.traceback} if outcome.traceback else {}),
    }
    write_json(folder / "trial.json", described)
    final = results / name
    if final.exists():
        # A folder cannot be renamed onto another: step aside, then in. See clean().
        aside = results / f".old-{name}-{os.getpid()}"
        os.replace(final, aside)
        os.replace(folder, final)
        shutil.rmtree(aside)
    else:
        os.replace(folder, final)
    return final


def write_plan(results: Path, head: Mapping[str, Any], rows: list[dict[str, Any]]) -> None:
    """Write ``plan.json``: ``head``, and under ``trials`` one line per planned trial.

    A row holds the trial's hash under ``trial``, its labels, its ``identity`` and the hash of
    the ``fit`` that it needs.
    """
    lines = ",\n  ".join(dumps(row) for row in rows)
    opening = dumps(head, indent=1).removesuffix("\n}")
    write_text(results / "plan.json", f'{opening},\n "trials": [\n  {lines}\n ]\n}}')


def clean(results: Path) -> None:
    """Undo what a killed run left half done. Call it with the results locked."""
    for folder in results.glob(".old-*"):
        place = results / folder.name.split("-")[1]
        if place.exists():
            shutil.rmtree(folder)
        else:
            os.replace(folder, place)
    for folder in results.glob(".tmp-*"):
        shutil.rmtree(folder)
    for file in results.glob(".*.json-*"):
        file.unlink()


@contextmanager
def locked(results: Path) -> Iterator[None]:
    """Only one run at a time writes to a results folder; a killed run leaves no lock."""
    try:
        results.mkdir(parents=True, exist_ok=True)
        lock = (results / ".lock").open("w")
    except OSError as error:
        raise InputError(f"{results}: cannot be written: {error.strerror}") from None
    with lock as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{results}: another run is writing there; wait for it or choose another --out"
            ) from None
        yield


# --- reading -----------------------------------------------------------------------------------


def load_plan(results: str | Path) -> dict[str, Any]:
    """The plan of the last run: suite, title, profile, baseline, report, labels and trials."""
    return read_json(_plan_file(results))


def load_trial(results: str | Path, trial: str) -> Stored:
    """One trial; a planned one that was not run is ``skipped``."""
    folder = Path(results) / trial
    path = folder / "trial.json"
    if path.is_file():
        return _stored(path)
    plan = _plan_file(results)
    row = _planned(plan, plan.stat().st_mtime_ns).get(trial)
    if row is None:
        raise InputError(f"{results}: no trial '{trial}'")
    labels = {key: row[key] for key in LABELS}
    return Stored(trial, row["identity"], labels, "skipped", NOT_RUN)


def stored(results: str | Path) -> list[str]:
    """Hashes of all trials in the folder."""
    found = Path(results).glob("*/trial.json")
    return sorted(path.parent.name for path in found if _HASH.fullmatch(path.parent.name))


def load_results(results: str | Path, all: bool = False) -> pd.DataFrame:
    """A row per record, at least one per planned trial; columns ``COLUMNS``.

    ``method`` is the label; ``scene`` is "" for a measure without one. A trial without a
    number has one row with ``value`` nan and the reason. Of a trial that is ``nonfinite``,
    only the rows that are so say it. With ``all``, trials of earlier plans follow.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    planned = load_plan(results)["trials"]
    for row in planned:
        rows += _rows(load_trial(results, row["trial"]), {key: row[key] for key in LABELS})
    if all:
        known = {row["trial"] for row in planned}
        for name in stored(results):
            if name not in known:
                stale = load_trial(results, name)
                rows += _rows(stale, stale.labels)
    frame = pd.DataFrame(rows, columns=COLUMNS)
    for column in ("value", "ci_low", "ci_high"):
        frame[column] = frame[column].astype("float64")
    return frame


# --- inside ------------------------------------------------------------------------------------


def _plan_file(results: str | Path) -> Path:
    path = Path(results) / "plan.json"
    if not path.is_file():
        raise InputError(f"{results}: holds no results (there is no plan.json)")
    return path


@lru_cache(maxsize=1)
def _planned(plan: Path, written: int) -> dict[str, dict[str, Any]]:
    """Rows of a plan by hash, of the file as it was ``written``; megabytes, asked for by each."""
    return {row["trial"]: row for row in read_json(plan)["trials"]}


def _stored(path: Path) -> Stored:
    data = read_json(path)
    try:
        return Stored(
            hash=data["trial"],
            trial=data["identity"],
            labels=data["labels"],
            status=data["status"],
            reason=data["reason"],
            records=[_numbers(record) for record in data["records"]],
            environment=data["environment"],
            started=data["started"],
            seconds=float(data["seconds"]),
            traceback=data.get("traceback", ""),
            folder=path.parent,
            shipped=data.get("shipped", ""),
            effects=data.get("effects", {}),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not a stored trial: {type(error).__name__} {error}") from None


def _rows(trial: Stored, labels: dict[str, Any]) -> list[dict[str, Any]]:
    common = {**labels, "trial": trial.hash}
    if not trial.records:
        empty = {"metric": "", "value": math.nan, "ci_low": math.nan, "ci_high": math.nan}
        return [{**common, **empty, "unit": "", "status": trial.status, "reason": trial.reason}]
    rows = []
    for record in trial.records:
        fine = trial.status == "nonfinite" and not math.isnan(record["value"])
        status, reason = ("ok", "") if fine else (trial.status, trial.reason)
        rows.append({**common, **record, "status": status, "reason": reason})
    return rows


def _record(record: Any) -> dict[str, Any]:
    return {
        "metric": record.metric,
        "value": float(record.value),
        "ci_low": float(record.ci_low),
        "ci_high": float(record.ci_high),
        "unit": record.unit,
    }


def _numbers(record: dict[str, Any]) -> dict[str, Any]:
    return {k: float(v) if k in ("value", "ci_low", "ci_high") else v for k, v in record.items()}


def _save_tensors(path: Path, tensors: Mapping[str, torch.Tensor]) -> None:
    from safetensors.torch import save_file

    # The format wants memory that is contiguous and not shared between tensors.
    save_file({key: t.detach().cpu().contiguous().clone() for key, t in tensors.items()}, path)
