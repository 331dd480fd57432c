"""Probes of the trials of ``identity_trials``, here or by an edited copy of the tree.

``python -m tests.identity_probes FOLDER trial:part ...`` writes ``FOLDER/trial part.npz``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from harness.core import registry
from harness.core.protocol.method import Budget
from harness.identity import ours
from harness.identity.probe import Probe
from harness.measures import registry as measures
from harness.runner.probing import Prober
from harness.suite import source_parts
from harness.suite.resolve import Resolved
from harness.suite.trials import Trial
from tests import identity_trials

Told = tuple[Probe, dict[str, str]]
"""A probe, and the units of its part with their hashes."""


class Jobs:
    """What a prober asks of the runner's jobs; methods are fitted for two steps."""

    def __init__(self) -> None:
        self.resolved = Resolved()

    def make(self, trial: Trial) -> Any:
        """With the fitted method alone."""
        method = registry.make(trial.method_name)
        material = self.resolved.material(trial)
        method.fit(material, trial.budget, torch.Generator().manual_seed(1))
        return SimpleNamespace(method=method)

    def scene(self, trial: Trial) -> Any:
        """As named."""
        return self.resolved.scene(trial)


def probe_of(asked: str) -> Told:
    """Of ``trial:part``, by the code of this process."""
    name, _, part = asked.partition(":")
    method, material, measure, scene = identity_trials.TRIALS[name]
    known = ours.digests(cached=False)
    kind = measures.load(measure)
    trial = Trial(
        hash="",
        identity={},
        suite="",
        material=str(material),
        method=method,
        scene=scene or "",
        measure=measure,
        seed=0,
        settings=measures.settings(measure, {}),
        method_name=method,
        budget=Budget(steps=2, conditions=8, directions=8, resolution=8, pool=16),
        material_spec=material,
        scene_spec=scene,
        timed=kind.timed,
    )
    placed = identity_trials.scene_part(scene) if scene else None
    parts = source_parts.parts_of(known, method, material, kind, placed)
    units = identity_trials.of_trial(known, name)[part].units
    return Prober(Jobs(), known).probe(trial, part, parts), dict(units)


def probes_by(tree: Path, folder: Path, asked: Iterable[str]) -> dict[str, Told]:
    """The same by the code of ``tree``, in a process of its own."""
    folder.mkdir(exist_ok=True)
    wanted = list(asked)
    done = subprocess.run(
        [sys.executable, "-m", "tests.identity_probes", str(folder), *wanted],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return {each: _read(folder / f"{each.replace(':', ' ')}.npz") for each in wanted}


def _read(file: Path) -> Told:
    with np.load(file) as found:
        arrays = {name: found[name] for name in found.files}
    units = json.loads(bytes(arrays.pop("units")))
    return Probe.unpacked(arrays), units


if __name__ == "__main__":
    from harness.mitsuba_runtime import variant

    variant.use("cpu")
    for each in sys.argv[2:]:
        probe, units = probe_of(each)
        text = np.frombuffer(json.dumps(units).encode(), np.uint8)
        np.savez(Path(sys.argv[1]) / f"{each.replace(':', ' ')}.npz", units=text, **probe.packed())
