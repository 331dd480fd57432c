"""Throughput of adapters beside Mitsuba's own sampler and integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import torch

from harness.analysis.records import throughput
from harness.core import registry
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.core.record import Raw, Record
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.measures.base import Job, Outcome
from harness.measures.throughput import Throughput
from harness.measures.timing import round_order
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.stats.intervals import median_interval

RESOLUTION, SPP = 128, 16
"""One pass of 262,144 camera rays."""
LONGEST = 2.0
"""Seconds that one render may take."""


@dataclass
class Rows:
    """A table to print."""

    title: str
    caption: str
    columns: list[str]
    cells: list[list[str]]


def run(
    names: list[str] | None,
    material_name: str,
    scene_name: str,
    device: str,
    rounds: int,
    steps: int,
    notify: Callable[[str], None],
) -> Rows:
    """Fit briefly, then time ``sample``, ``pdf`` and renders in interleaved rounds."""
    variant.use(device)
    material = materials.make(material_name)
    scene = scenes.make(scene_name)
    native = _native_times(scene, material, rounds, notify)
    jobs = []
    for name in names or registry.names():
        method = registry.make(name)
        supported, reason = method.supports(material)
        if not supported:
            notify(f"{name}: {reason}")
            continue
        notify(f"fitting {name}")
        budget = Budget(steps=steps, pool=256, device=device)
        method.fit(material, budget, torch.Generator().manual_seed(0))
        jobs.append(_job(name, method, material, budget, rounds))
        if (twin := method.in_torch()) is not None:
            # What the same network costs without columns; timed alone, not in a render.
            jobs.append(_job(f"{name}, torch", twin, material, budget, rounds))
    outcomes = Throughput().run(jobs, notify)
    timed = [_numbers(job, outcome) for job, outcome in zip(jobs, outcomes, strict=True)]
    renders = _render_times(jobs, timed, scene, material, rounds, notify)
    cells = []
    for job, value, seconds in zip(jobs, timed, renders, strict=True):
        sample, pdf = value["samples-per-second"], value["pdf-queries-per-second"]
        ratio = f"{np.median(seconds) / np.median(native):.3g}" if len(seconds) else "too slow"
        cells.append(
            [
                job.trial.name,
                _millions(sample),
                _millions(pdf),
                f"{int(value['batch'].value):,}",
                _milliseconds(seconds) if len(seconds) else "too slow",
                ratio,
            ]
        )
    cells.append(["Mitsuba alone", "", "", "", _milliseconds(native), "1"])
    return Rows(
        title=f"{material.name} on {device}: medians [95 % interval] of {rounds} rounds",
        caption=(
            f"render: {scene.name}, {RESOLUTION} x {RESOLUTION} pixels, direct light by BSDF"
            f" sampling, passes of {SPP} spp; 'Mitsuba alone' is its own BSDF and sampler"
        ),
        columns=[
            "method",
            "M samples/s",
            "M pdf queries/s",
            "batch",
            "render ms/spp",
            "x Mitsuba alone",
        ],
        cells=cells,
    )


def _job(name: str, method, material: Material, budget: Budget, rounds: int) -> Job:
    return Job(
        trial=SimpleNamespace(name=name),
        material=material,
        method=method,
        scene=None,
        seed=0,
        generator=torch.Generator().manual_seed(1),
        settings=measures.settings("throughput", {"rounds": rounds}),
        budget=budget,
        make=lambda: registry.make(name),
    )


def _numbers(job: Job, outcome: Outcome) -> dict[str, Record]:
    """By metric."""
    raw = Raw(outcome.arrays, outcome.documents, job.settings)
    return {record.metric: record for record in throughput.numbers(raw).records}


def _native_times(
    scene, material: Material, rounds: int, notify: Callable[[str], None]
) -> np.ndarray:
    """Seconds per spp [rounds] of Mitsuba with the material's own sampler.

    Before any method is built: Mitsuba compiles every BSDF that exists into its kernel.
    """
    from harness.rendering.prepared import prepare_native

    notify("rendering with Mitsuba alone")
    prepared = prepare_native(scene, material, RESOLUTION, "bsdf")
    for seed in range(3):
        prepared.render(SPP, seed)
    return np.array([prepared.render(SPP, 10 + n).seconds / SPP for n in range(rounds)])


def _render_times(
    jobs: list[Job],
    timed: list[dict[str, Record]],
    scene,
    material: Material,
    rounds: int,
    notify: Callable[[str], None],
) -> list[np.ndarray]:
    """Seconds per spp [rounds] of every job, in interleaved rounds.

    Empty for a method that by its throughput would need longer than ``LONGEST`` for one
    sample in every pixel.
    """
    from harness.rendering.prepared import prepare

    prepared, spp = {}, {}
    for i, (job, value) in enumerate(zip(jobs, timed, strict=True)):
        rate = value["samples-per-second"].value
        if RESOLUTION**2 / rate > LONGEST:
            continue
        prepared[i] = prepare(scene, material, job.method, RESOLUTION)
        spp[i] = SPP if RESOLUTION**2 * SPP / rate < LONGEST else 1
        for seed in range(2):
            prepared[i].render(spp[i], seed)
    ready = list(prepared.items())
    times: list[list[float]] = [[] for _ in jobs]
    for number in range(rounds):
        notify(f"rendering round {number + 1} of {rounds}")
        for place in round_order(len(ready), number):
            i, p = ready[place]
            times[i].append(p.render(spp[i], seed=10 + number).seconds / spp[i])
    return [np.array(t) for t in times]


def _millions(record) -> str:
    value, low, high = (v / 1e6 for v in (record.value, record.ci_low, record.ci_high))
    return f"{value:.3g} [{low:.3g}, {high:.3g}]"


def _milliseconds(seconds: np.ndarray) -> str:
    value, low, high = (v * 1e3 for v in median_interval(seconds))
    return f"{value:.3g} [{low:.3g}, {high:.3g}]"
