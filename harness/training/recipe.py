"""From a description of microgeometry to a stored neural material, by one call."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from harness.core import machine
from harness.core.protocol.errors import InputError
from harness.materials.neural import storage
from harness.materials.neural.architecture import Architecture
from harness.microgeometry import descriptions, queries
from harness.microgeometry.description import read
from harness.training import energy, parallax
from harness.training.changes import changed
from harness.training.profiles import Profile
from harness.training.profiles import profile as find_profile
from harness.training.quality import Held, footprints
from harness.training.training import Data, Training

_RAYS, _ENERGIES, _DIRECTIONS, _AGAIN = (k << 40 for k in (4, 5, 6, 7))
"""Between a training's seed and those of its rays, its energies, what these are compared at,
and queries drawn after it."""

_QUERIES_A_STEP = 1 << 13
"""That :func:`refine` traces; its steps see each of them four times."""

Notify = Callable[[str, float], None]
"""``notify(what is being done, share of the whole)``."""


def train(
    description: str | Path,
    out: Path,
    profile: str = "quick",
    seed: int = 0,
    device: str = "cpu",
    resume: bool = False,
    notify: Notify = lambda _text, _share: None,
    changes: Sequence[str] = (),
) -> dict[str, Any]:
    """Train the material of a description and store it as ``out``; returns its record.

    An interrupted training leaves ``out`` with the suffix ``.train`` beside it, from which
    ``resume`` goes on; a finished one removes it. ``changes`` are sizes of the network
    and numbers of the profile that differ, as ``KEY=VALUE``.

    Raises:
        InputError: no such description, profile or file to resume from.
        KeyboardInterrupt: interrupted; what was trained so far is stored.
    """
    if out.suffix != ".safetensors":
        raise InputError(f"--out {out}: expected a name that ends in .safetensors")
    chosen = changed(find_profile(profile), changes)
    surface = descriptions.load(description)
    out.parent.mkdir(parents=True, exist_ok=True)
    under_way = out.with_suffix(".train")
    taught = bool(chosen.offset_steps and chosen.architecture.offset and parallax.known(surface))
    training = Training(chosen, seed, device, taught)
    labels = {"surface": str(surface.identity()), "profile": str(chosen), "device": device}
    if resume:
        if not under_way.is_file():
            raise InputError(f"--resume: there is no {under_way} to go on from")
        training.load(under_way, labels)
    data, data_seconds = _data(surface, training, chosen, notify)
    if taught and training.step == 0:
        training.seconds += parallax.teach(
            training.network.offset,
            surface,
            chosen.offset_steps,
            seed + _RAYS,
            device,
            lambda share: notify("teaching the offset where rays hit", share),
        )

    def step(done: int, loss: float) -> None:
        notify(f"training, loss {loss:.4f}", done / training.total)
        training.save(under_way, labels)

    try:
        training.run(data, step)
    except KeyboardInterrupt:
        training.save(under_way, labels)
        raise
    if chosen.energy_steps and energy.able(surface, training.network):
        data_seconds += _energies(training, surface, data, chosen.energy_steps, notify)
    record = {
        "name": surface.name,
        "about": getattr(read(descriptions.find(description)), "about", ""),
        "description": surface.identity(),
        "profile": {"name": profile, **asdict(chosen)},
        "seed": seed,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "environment": machine.describe(device),
        "data_seconds": round(data_seconds, 2),
        "train_seconds": round(training.seconds, 2),
        "steps": training.step,
        "final_loss": training.history[-1],
    }
    _store(training, surface, record, out, notify)
    under_way.unlink(missing_ok=True)
    return record


def refine(
    file: Path,
    steps: int = 800,
    device: str = "cpu",
    notify: Notify = lambda _text, _share: None,
) -> dict[str, Any]:
    """Teach a stored material energies in ``steps`` steps, as a training's end; rewrites ``file``.

    For materials from before that was a part of trainings, or with another surface's energies
    than now. It goes on from textures in half precision, so it ends not quite as a training does.
    The record keeps the seconds that it took, and returns.

    Raises:
        InputError: no material of ours, no description of its microgeometry, or a pyramid.
    """
    record, surface = _of(file)
    known = {field.name for field in fields(Profile)}
    about = {key: value for key, value in record["profile"].items() if key in known}
    chosen = Profile(**{**about, "architecture": Architecture.of(about["architecture"], str(file))})
    training = Training(chosen, record["seed"], device)
    training.network.load_state_dict(storage.load(file).state_dict())
    training.step = training.total
    if not energy.able(surface, training.network):
        raise InputError(f"{file}: expected a material of one resolution, of a traced surface")
    asked = replace(chosen, queries=steps * _QUERIES_A_STEP)
    data, seconds = _data(surface, training, asked, notify, _AGAIN)
    seconds += _energies(training, surface, data, steps, notify)
    # They are of the network before.
    for key in ("quality_when_trained", "measured"):
        record.pop(key, None)
    record["refined"] = {
        "steps": steps,
        "data_seconds": round(seconds, 2),
        "train_seconds": round(training.seconds, 2),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    _store(training, surface, record, file, notify)
    return record


def measure(file: Path, seed: int = 0, device: str = "cpu") -> dict[str, Any]:
    """Measure the errors of a stored material again, by its record's microgeometry.

    The file keeps its tensors; ``quality`` in its record is replaced, and the record returned.
    What it was is kept once as ``quality_when_trained``, to compare with
    ``quality_in_single_precision``, whose textures are not stored to be measured alike.

    Raises:
        InputError: no material of ours, or no description of its microgeometry is found.
    """
    record, surface = _of(file)
    network = storage.load(file).to(device)
    held = Held.draw(surface, seed, footprints(network), device=device)
    record.setdefault("quality_when_trained", record.get("quality"))
    record["quality"] = held.measure(network).as_dict()
    record["measured"] = datetime.now(UTC).isoformat(timespec="seconds")
    storage.save(file, network.cpu(), record)
    return record


def _of(file: Path) -> tuple[dict[str, Any], Any]:
    """The record of a stored material, and the surface that it was trained on."""
    record = storage.record(file)
    if "name" not in record:
        raise InputError(f"{file}: its record names no microgeometry to measure it by")
    surface = descriptions.load(record["name"])
    now, then = json.loads(json.dumps(surface.identity())), record.get("description", {})
    # The hash of the code that traces changes with every word of it.
    if {**now, "source": ""} != {**then, "source": ""}:
        raise InputError(f"{file}: was trained on another '{record['name']}' than there is now")
    return record, surface


def _store(
    training: Training, surface: Any, record: dict[str, Any], out: Path, notify: Notify
) -> None:
    """Measure the network and write it with ``record``, to which the errors are added."""
    notify("measuring the errors", 1.0)
    network = training.network.eval()
    held = Held.draw(surface, training.seed, footprints(network), device=training.device)
    record["quality_in_single_precision"] = held.measure(network).as_dict()
    # Twice: what is measured last is what is stored, with its textures rounded.
    network.cpu()
    storage.save(out, network, record)
    record["quality"] = held.measure(storage.load(out).to(training.device)).as_dict()
    storage.save(out, network, record)


def _energies(training: Training, surface: Any, data: Data, steps: int, notify: Notify) -> float:
    """The end of a training; returns the seconds of tracing."""
    count = min(energy.CONDITIONS, energy.STEP * steps)
    notify(f"tracing {count:,} energies", 1.0)
    start = time.perf_counter()
    kernel, seed = footprints(training.network), training.seed
    known = energy.draw(surface, kernel, count, seed + _ENERGIES, training.device)
    seconds = time.perf_counter() - start
    energy.teach(
        training, known, data, steps, seed + _DIRECTIONS, lambda share: notify("energies", share)
    )
    return seconds


def _data(
    surface: Any, training: Training, profile: Profile, notify: Notify, apart: int = 0
) -> tuple[Data, float]:
    """The queries of the whole training, drawn anew after a resumption: the same ones.

    ``apart`` from the training's seed they are others.
    """
    notify(f"tracing {profile.queries:,} queries", 0.0)
    start = time.perf_counter()
    kernel = footprints(training.network)
    drawn = queries.draw(
        surface,
        profile.queries,
        training.seed + apart,
        kernel,
        profile.samples,
        device=training.device,
    )
    return Data(*drawn), time.perf_counter() - start
