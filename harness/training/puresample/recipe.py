"""From a description to a stored material learned from walks, by one call."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch

from harness.core import machine
from harness.core.protocol.errors import InputError
from harness.materials.puresample import storage
from harness.materials.puresample.network import PureSample
from harness.training.changes import changed
from harness.training.puresample import albedo, data, density, sources
from harness.training.puresample.descent import UnderWay
from harness.training.puresample.profiles import Profile
from harness.training.puresample.profiles import profile as find_profile
from harness.training.puresample.quality import Held

_ALBEDO = 10 << 40
"""Between a training's seed and that of the albedo's walks."""

Notify = Callable[[str, float], None]


def train(
    description: str | Path,
    out: Path,
    profile: str = "quick",
    seed: int = 0,
    device: str = "cpu",
    notify: Notify = lambda _text, _share: None,
    changes: Sequence[str] = (),
    resume: bool = False,
) -> dict[str, Any]:
    """Learn the material of a description from its walks and store it as ``out``; its record.

    An interrupted training leaves ``out`` with the suffix ``.train`` beside it, from which
    ``resume`` goes on, with the same walks drawn again; a finished one removes it. ``changes`` are
    sizes of the networks and numbers of the profile that differ, ``KEY=VALUE``.

    Raises:
        InputError: no such description or profile; a surface of which nothing can be learned.
    """
    if out.suffix != ".safetensors":
        raise InputError(f"--out {out}: expected a name that ends in .safetensors")
    chosen = checked(changed(find_profile(profile), changes))
    file = out.with_suffix(".train")
    if resume and not file.is_file():
        raise InputError(f"--resume: there is no {file} to go on from")
    source = sources.load(description)
    if source.grey:
        chosen = replace(chosen, architecture=replace(chosen.architecture, grey=True))
    notify(f"{chosen.walks:,} walks", 0.0)
    start = time.perf_counter()
    walked = data.draw(source, chosen.walks, seed, device)
    data.check(source, walked.counts)
    survival = albedo.draw(
        source,
        chosen.directions,
        chosen.group,
        seed + _ALBEDO,
        device,
        spread=not chosen.architecture.textured,
    )
    data_seconds = time.perf_counter() - start
    out.parent.mkdir(parents=True, exist_ok=True)
    labels = {
        "surface": str(source.identity()),
        "profile": str(chosen),
        "seed": seed,
        "device": device,
    }
    under_way = UnderWay(file, labels)
    network = fitted(chosen, walked, survival, seed, device, notify, under_way, resume)
    record = {
        "name": source.name,
        "about": source.about,
        "description": source.identity(),
        "profile": {"name": profile, **asdict(chosen)},
        "seed": seed,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "environment": machine.describe(device),
        "data_seconds": round(data_seconds, 2),
        "train_seconds": round(under_way.seconds, 2),
        "walks": vars(walked.counts),
    }
    _store(network, source, record, out, device, notify)
    file.unlink(missing_ok=True)
    return record


def fitted(
    profile: Profile,
    walked: data.Walked,
    survival: albedo.Survival,
    seed: int,
    device: str = "cpu",
    notify: Notify = lambda _text, _share: None,
    under_way: UnderWay | None = None,
    resume: bool = False,
) -> PureSample:
    """The networks of those walks: density and texture, then the albedo with the texture frozen.

    ``under_way`` keeps its state as it goes, from which ``resume`` goes on.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = PureSample(profile.architecture).to(device)
    if under_way is not None and resume:
        under_way.load(network)
    density.fit(network, walked.survivors(), profile, seed, device, notify, under_way)
    albedo.fit(network, survival, profile, seed, device, notify, under_way)
    return network.cpu().eval()


def measure(file: Path, seed: int = 0, device: str = "cpu") -> dict[str, Any]:
    """Measure the errors of a stored material again, by its record's description.

    Raises:
        InputError: its description is not there, or is another now.
    """
    record = storage.record(file)
    if not {"name", "description"} <= set(record):
        raise InputError(f"{file}: has no record of what it was learned from")
    try:
        source = sources.of_record(record)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    network = storage.load(file)
    held = Held.draw(source, seed, network.architecture.textured, device=device)
    record["quality"] = held.measure(network).as_dict()
    record["measured"] = {"seed": seed, "environment": machine.describe(device)}
    storage.save(file, network, record)
    return record


def _store(
    network: PureSample,
    source: Any,
    record: dict[str, Any],
    out: Path,
    device: str,
    notify: Notify,
) -> dict[str, Any]:
    """Write it, measure what was written, and write the errors beside it."""
    notify("measuring the errors", 1.0)
    storage.save(out, network, record)
    stored = storage.load(out)
    held = Held.draw(source, record["seed"], stored.architecture.textured, device=device)
    record["quality"] = held.measure(stored).as_dict()
    storage.save(out, stored, record)
    return record


def checked(profile: Profile) -> Profile:
    """``profile``, if a training can be done with its numbers."""
    albedo.loss_of(profile.albedo_loss, torch.zeros(1, 3), torch.zeros(1, 3))  # a name it knows
    least = min(profile.walks, profile.directions, profile.albedo_batch, profile.matching_batch)
    if least < 1 or profile.group < 2:
        raise InputError("--set: expected at least one walk, direction and row, and groups of two")
    return profile
