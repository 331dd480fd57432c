"""A material, measures and adapters that cost nothing, to test the machinery around them."""

from __future__ import annotations

import math
import os
import time
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import yaml

from harness import Material
from harness.core.protocol.errors import InputError
from harness.core.record import Record
from harness.identity.digests import Part
from harness.identity.ours import digests
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.measures.base import Job, Measure, Outcome, Settings
from harness.runner import executor, machine_lock
from harness.runner.probes import Probes
from harness.scenes import registry as scenes
from harness.suite import source_parts

ADAPTERS = '''
"""Adapters for tests."""
import math, os, time
import torch
from harness import DiskSample, FitReport, Method
from harness import BudgetExceeded, Unsupported, square_to_disk


class Good(Method):
    """Uniform on the disk."""

    def sample(self, condition, u):
        return DiskSample(square_to_disk(u[:, :2]), torch.full((len(u),), 1 / math.pi))

    def pdf(self, condition, wo):
        return torch.full((len(wo),), 1 / math.pi)


class Named(Good):
    name = "with-state"

    def __init__(self, scale: float = 1.0):
        self.scale, self.weights = scale, torch.zeros(3)

    def fit(self, material, budget, generator):
        self.weights = torch.rand(3, generator=generator) * self.scale
        return FitReport(steps=budget.steps, parameters=3, loss=[2.0, 1.0])

    def state_dict(self):
        return {"weights": self.weights}

    def load_state_dict(self, state):
        self.weights = state["weights"]


class Raises(Good):
    def fit(self, material, budget, generator):
        raise RuntimeError("no luck\\nsecond line")


class WrongShape(Good):
    def pdf(self, condition, wo):
        return torch.ones(len(wo), 1)


class Nan(Good):
    def pdf(self, condition, wo):
        return torch.full((len(wo),), math.nan)


class NotSample(Good):
    def sample(self, condition, u):
        return u[:, :2]


class Slow(Good):
    def fit(self, material, budget, generator):
        raise BudgetExceeded("took 2 s of 1 s")


class Choosy(Good):
    def supports(self, material):
        return False, "wants features"


class FailsOnce(Good):
    def fit(self, material, budget, generator):
        if os.path.exists(os.environ["FAKE_FLAG"]):
            raise RuntimeError("flag is up")
        return FitReport()


class BadInRender(Good):
    """Breaks in the timed measure only."""


class Endless(Good):
    def fit(self, material, budget, generator):
        open(os.environ["FAKE_FLAG"], "w").close()
        time.sleep(60)
        return FitReport()


class NoMethod:
    pass


class NoPdf(Method):
    def sample(self, condition, u):
        return None
'''


class FakeMaterial(Material):
    """Lambertian."""

    def __init__(self, name: str):
        self.name = name

    def eval(self, condition: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
        return torch.full((len(wo), 3), 1 / math.pi)

    def identity(self) -> dict[str, Any]:
        return {"fake": self.name}


class Probe(Measure):
    """One number per method; ``poison`` makes it nan."""

    name = "probe"
    needs_scene = False
    calls: list[str] = []

    class Settings(Settings):
        rows: int = 8
        poison: bool = False

    def run(self, jobs: list[Job], notify: Any) -> list[Outcome]:
        assert len(jobs) == 1
        Probe.calls.append(jobs[0].trial.method)
        return [self._one(job) for job in jobs]

    def _one(self, job: Job) -> Outcome:
        condition = job.material.conditions(job.settings["rows"], job.generator)
        value = float(job.method.pdf(condition, condition[:, -2:]).mean())
        weights = getattr(job.method, "weights", torch.zeros(3))
        return Outcome(
            records=[
                Record("mean-pdf", math.nan if job.settings["poison"] else value, 0.0, 1.0, "1"),
                Record("weight", float(weights.sum())),
            ],
            arrays={"weights": weights.numpy()},
            images={"flat": np.full((4, 4, 3), 0.5)},
            documents={"note": "kept"},
        )


class Clock(Measure):
    """A timed measure in a scene."""

    name = "clock"
    timed = True
    calls: list[list[str]] = []

    class Settings(Settings):
        resolution: int = 16

    def run(self, jobs: list[Job], notify: Any) -> list[Outcome]:
        Clock.calls.append([job.trial.method for job in jobs])
        assert sum(job.baseline for job in jobs) == 1
        if any(job.trial.method == "BadInRender" for job in jobs):
            raise RuntimeError("broke in the render")
        time.sleep(0.001)
        return [Outcome(records=[Record("seconds", 0.5, unit="s")]) for _ in jobs]


def _identity(spec: Any) -> dict[str, Any]:
    name = _name(spec)
    if not name.startswith("fake"):
        raise InputError(f"unknown material '{name}'")
    return {"fake": name} | ({} if isinstance(spec, str) else {"rest": sorted(spec)})


def _scene(spec: Any) -> SimpleNamespace:
    _identity(spec)
    return SimpleNamespace(name=_name(spec), effects=("environment",))


def _material_entries(spec: Any) -> list[str]:
    digests().tree.roots["tests"] = Path(__file__).parent
    return ["tests.fakes:FakeMaterial"]


def install(setattr_: Any = setattr) -> None:
    """Replace the registries of materials and scenes, and add two measures.

    No probes are made, which take a second each, and no run waits for what another one times.
    """
    setattr_(machine_lock, "machine", lambda note, alone=True: nullcontext())
    setattr_(executor, "default", executor.INLINE)  # another process would not know them
    setattr_(Probes, "keep", lambda self, trials, note: None)
    for registry in (materials, scenes):
        setattr_(registry, "identity", _identity)
    setattr_(materials, "make", lambda spec, base=None: FakeMaterial(_name(spec)))
    setattr_(scenes, "identity_of", lambda spec, scene, base=None: _identity(spec))
    setattr_(scenes, "make", _scene)
    setattr_(source_parts, "_material", _material_entries)
    setattr_(source_parts, "scene", lambda *about: Part(("tests.fakes:_scene",)))
    setattr_(measures, "_EXTRA", {measure.name: measure for measure in (Probe, Clock)})
    Probe.calls.clear()
    Clock.calls.clear()


def _name(spec: Any) -> str:
    return spec if isinstance(spec, str) else spec["name"]


def suite(folder: Path, **changes: Any) -> Path:
    """Write a suite of fakes and the adapters it names; ``None`` takes a key away."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "adapters.py").write_text(ADAPTERS)
    data = {
        "name": "fakes",
        "materials": ["fake-a", "fake-b"],
        "methods": ["adapters.py:Good", "adapters.py:Named"],
        "scenes": ["fake-room"],
        "measures": ["probe", "clock"],
        "baseline": "Good",
    } | changes
    path = folder / "suite.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in data.items() if v is not None}))
    return path


def drive(arguments: list[str]) -> int:
    """The command line with the fakes installed; for a process of its own."""
    from harness.cli.main import main

    install()
    return main(arguments)


if __name__ == "__main__":
    import sys

    os._exit(drive(sys.argv[1:]))
