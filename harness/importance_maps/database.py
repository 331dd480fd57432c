"""A data base of importance maps of one material: made once, resumable, used by every fit.

A folder of shards of ``SHARD`` maps. What a shard holds depends on the settings, the material
and the shard's number alone: an interrupted run goes on where it stopped, a larger one
adds shards to a smaller one's, and what was made twice is the same to the bit.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.importance_maps.maps import checked_kind, make_map
from harness.importance_maps.slices import Slice, slices_of

SHARD = 64
MANIFEST = "database.json"
FORMAT = 1
_STEPS = 32767
"""Directions are stored in 16 bits with a fixed point: 3e-5 everywhere. Half precision would
have 5e-4 near the rim, a twentieth of the width of a lobe of roughness 0.01."""
WORKERS = 2


@dataclass(frozen=True)
class BakeSettings:
    """What determines a data base, beside its material.

    Maps have ``resolution``^2 cells, the slices they are made of ``slice_resolution``^2.
    """

    kind: str = "optimal-transport"
    resolution: int = 64
    slice_resolution: int = 64
    seed: int = 0

    def __post_init__(self) -> None:
        checked_kind(self.kind, "importance maps")
        if self.resolution < 2 or self.slice_resolution < 2:
            raise InputError(
                "importance maps: expected resolutions of at least 2, not"
                f" {self.resolution} and {self.slice_resolution}"
            )


@dataclass(frozen=True)
class Maps:
    """P maps: ``condition`` [P, C], ``wo`` [P, R, R, 2] (row ``u[1]``, column ``u[0]``).

    ``rgb`` [P, S, S, 3] are the slices, in units of ``scale`` [P, 1, 1, 1]. ``seconds`` is what
    it took to make them, ``black`` how many conditions reflect nothing and were left out.
    """

    condition: Tensor
    wo: Tensor
    rgb: Tensor
    scale: Tensor
    seconds: float = 0.0
    black: int = 0

    def __len__(self) -> int:
        return len(self.condition)

    @classmethod
    def of(cls, shards: list[dict[str, Tensor]], seconds: float = 0.0) -> Maps:
        """Shards put together."""
        whole = {name: torch.cat([s[name] for s in shards]) for name in shards[0]}
        return cls(
            condition=whole["condition"],
            wo=whole["wo"].float() / _STEPS,
            rgb=whole["rgb"],
            scale=whole["scale"],
            seconds=seconds,
            black=int(whole["black"].sum()),
        )


def bake(
    material: Material,
    settings: BakeSettings,
    count: int,
    *,
    device: str = "cpu",
    workers: int = WORKERS,
    deadline: float = float("inf"),
) -> Maps:
    """``count`` maps of random conditions, in memory.

    Raises:
        TimeoutError: ``time.perf_counter()`` passed ``deadline``.
    """
    start = time.perf_counter()
    shards = []
    with _mapper(workers if count > SHARD else 1) as mapper:
        for index, size in _sizes(count):
            if time.perf_counter() > deadline:
                raise TimeoutError(f"{index * SHARD} of {count} importance maps were made")
            shards.append(_shard(material, settings, index, size, device, mapper))
    return Maps.of(shards, time.perf_counter() - start)


def bake_to(
    folder: Path,
    material: Material,
    settings: BakeSettings,
    count: int,
    *,
    device: str = "cpu",
    workers: int = WORKERS,
    resume: bool = False,
    notify: Callable[[int, int], None] = lambda done, of: None,
) -> int:
    """At least ``count`` maps in ``folder``, whole shards; returns how many shards were made.

    ``notify(done, of)`` counts maps. A shard appears whole or not at all.

    Raises:
        InputError: the folder holds another data base, or one and ``resume`` is not set.
    """
    manifest = _manifest(material, settings)
    path = folder / MANIFEST
    if path.exists():
        _refuse_another(path, manifest)
        if not resume:
            raise InputError(f"{folder}: holds this data base already; --resume continues it")
    else:
        folder.mkdir(parents=True, exist_ok=True)
        _write(path, lambda part: part.write_text(json.dumps(manifest, indent=1) + "\n"))
    made, shards = 0, -(-count // SHARD)
    with _mapper(workers) as mapper:
        for index in range(shards):
            file = folder / _name(index)
            if not file.exists():
                found = _shard(material, settings, index, SHARD, device, mapper)
                _write(file, lambda part, found=found: save_file(found, part))
                made += 1
            notify((index + 1) * SHARD, shards * SHARD)
    return made


def load(folder: Path, material: Material, count: int | None = None) -> Maps:
    """The first ``count`` maps of a data base (all without).

    Raises:
        InputError: there is none, it is of another material, or smaller than that.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError(f"{folder}: no data base of importance maps (no {MANIFEST})")
    stored = json.loads(path.read_text())
    if stored["material"] != json.loads(json.dumps(material.identity())):
        raise InputError(f"{folder}: importance maps of another material than '{material.name}'")
    files = sorted(folder.glob("maps-*.safetensors"))
    needed = len(files) if count is None else -(-count // SHARD)
    if needed > len(files) or not files:
        raise InputError(f"{folder}: holds {len(files) * SHARD} maps, expected {count or 1}")
    shards = [load_file(file) for file in files[:needed]]
    maps = Maps.of(shards)
    return maps if count is None else Maps(*(v[:count] for v in _tensors(maps)), 0.0, maps.black)


def _tensors(maps: Maps) -> tuple[Tensor, ...]:
    return maps.condition, maps.wo, maps.rgb, maps.scale


def _name(index: int) -> str:
    return f"maps-{index:05d}.safetensors"


def _sizes(count: int) -> Iterator[tuple[int, int]]:
    for index in range(-(-count // SHARD)):
        yield index, min(SHARD, count - index * SHARD)


def _manifest(material: Material, settings: BakeSettings) -> dict:
    what = {"format": FORMAT, "material": material.identity(), **asdict(settings)}
    return json.loads(json.dumps(what))


def _refuse_another(path: Path, manifest: dict) -> None:
    try:
        stored = dict(json.loads(path.read_text()))
    except (OSError, ValueError, TypeError, RecursionError):
        raise InputError(f"{path}: does not describe a data base of importance maps") from None
    for key in manifest:
        if stored.get(key) != manifest[key]:
            what = "" if key == "material" else f": {stored.get(key)!r}, not {manifest[key]!r}"
            raise InputError(f"{path.parent}: holds maps of another {key}{what}")


def _write(path: Path, write: Callable[[Path], object]) -> None:
    part = path.with_name(path.name + f".part-{os.getpid()}")
    write(part)
    part.replace(path)


def _shard(
    material: Material,
    settings: BakeSettings,
    index: int,
    size: int,
    device: str,
    mapper: Callable,
) -> dict[str, Tensor]:
    """Maps ``index * SHARD`` on, ``size`` of them, without those of black conditions."""
    generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + index)
    # All of a shard's conditions, whatever its size: the first ones are then always the same.
    condition = material.conditions(SHARD, generator, device)[:size]
    seed = int(torch.randint(1 << 30, (), generator=generator))
    rgb = slices_of(material, condition, settings.slice_resolution, seed).cpu()
    scale = rgb.abs().amax((1, 2, 3), keepdim=True)
    lit = scale.flatten() > 0
    rgb, scale = rgb[lit], scale[lit]
    half = (rgb / scale).half()
    # Maps are made of the slices as they are stored, so that both are of one density.
    slices = (half.double() * scale.double()).numpy()
    work = [(s, settings.resolution, settings.kind) for s in slices]
    wo = (
        np.stack(list(mapper(_one, work))) if work else np.zeros((0, *[settings.resolution] * 2, 2))
    )
    return {
        "condition": condition.cpu()[lit].contiguous(),
        # Towards zero, so that no direction leaves the disk.
        "wo": torch.from_numpy(np.trunc(wo * _STEPS).astype(np.int16)),
        "rgb": half.contiguous(),
        "scale": scale.float().contiguous(),
        "black": (~lit).sum()[None],
    }


def _one(work: tuple[np.ndarray, int, str]) -> np.ndarray:
    rgb, resolution, kind = work
    return make_map(Slice(rgb), resolution, kind).wo


@contextmanager
def _mapper(workers: int) -> Iterator[Callable]:
    """``map`` over processes; in this one if there is to be one only."""
    if workers <= 1:
        yield map
        return
    # Not by fork: Dr.Jit and OpenMP have threads, which a fork leaves behind.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield lambda function, work: pool.map(function, work, chunksize=4)
