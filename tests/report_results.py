"""Results folders made up for tests of the report, through the store's own writer."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from harness.analysis.process_pooling import together
from harness.core.record import Record
from harness.measures.base import Outcome
from harness.store import write
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored

METHODS = {  # label: (registry name, variance over the ideal, nanoseconds per sample)
    "cosine": ("cosine", 30.0, 95.0),
    "blinn-phong": ("blinn-phong", 9.0, 120.0),
    "improved-baseline": ("improved-baseline", 5.0, 130.0),
    "fan-baseline": ("improved-baseline", 12.0, 128.0),
    "two-lobe": ("two-lobe", 3.2, 140.0),
    "realnvp": ("realnvp", 3.6, 420.0),
    "neural-spline-flow": ("neural-spline-flow", 1.35, 330.0),
    "histogram": ("histogram", 6.0, 260.0),
    "histogram-mixture": ("histogram-mixture", 1.6, 150.0),
    "tabulated": ("tabulated", 1.02, 900.0),
    "native": ("native", 2.4, 90.0),
}
MATERIALS = (
    "veined-marble elephant-hide quilted-satin saddle-leather brocade molten-metal "
    "brushed-metal star-tiles suede tortoise-shell wood-panel hull-panel"
).split()
MEASURES = ("fit", "pdf", "equal-spp", "equal-time", "convergence", "slices")
SCENELESS = ("fit", "pdf", "slices")
MACHINE = {"cpu": "Example CPU 3000 @ 2.40GHz", "cores": 2}


@dataclass
class Made:
    """What the folder is made of; ``fail`` maps (measure, method, material) to (status, reason).

    ``None`` inside a key stands for any; the first match counts. ``bias`` maps (method,
    material) to a p-value.
    """

    materials: list[str] = field(default_factory=lambda: MATERIALS[:3])
    methods: list[str] = field(default_factory=lambda: list(METHODS)[:5])
    measures: tuple[str, ...] = MEASURES
    scenes: tuple[str, ...] = ("studio-sphere",)
    seeds: tuple[int, ...] = (0,)
    fail: dict[tuple, tuple[str, str]] = field(default_factory=dict)
    bias: dict[tuple[str, str], float] = field(default_factory=dict)
    report: dict | None = None
    title: str = "Speed-up of learned samplers"
    size: int = 32
    rounds: int = 8
    machine: dict = field(default_factory=lambda: MACHINE)
    not_run: tuple[str, ...] = ()

    def write(self, folder: Path) -> Path:
        """The whole folder."""
        folder.mkdir(parents=True, exist_ok=True)
        head = {
            "suite": "synthetic",
            "title": self.title,
            "profile": "quick",
            "baseline": "improved-baseline",
            "report": self.report or {"tables": None, "figures": None},
        }
        with ResultsFolder(folder, write=True) as store:
            rows = [
                self._trial(store, measure, material, method, scene, seed)
                for material in self.materials
                for seed in self.seeds
                for method in self.methods
                for measure in self.measures
                for scene in (("",) if measure in SCENELESS else self.scenes)
            ]
            store.write_plan(head, rows)
        (folder / "suite.yaml").write_text("name: synthetic\n", encoding="utf-8")
        return folder

    def _trial(
        self,
        store: ResultsFolder,
        measure: str,
        material: str,
        method: str,
        scene: str,
        seed: int,
    ) -> dict:
        name = METHODS.get(method, (method, 4.0, 200.0))[0]
        identity = {
            "material": {"name": material},
            "method": {"name": name, "params": {"label": method} if name != method else {}},
            "measure": {"name": measure, "settings": {"resolution": self.size}},
            "scene": scene,
            "seed": seed,
        }
        if measure in ("equal-time", "fit", "convergence"):
            identity["machine"] = self.machine
        text = json.dumps(identity, sort_keys=True)
        hashed = hashlib.sha256(text.encode()).hexdigest()[:16]
        labels = {
            "suite": "synthetic",
            "material": material,
            "method": method,
            "scene": scene,
            "measure": measure,
            "seed": seed,
        }
        if measure not in self.not_run:
            outcome = self._outcome(measure, material, method, seed, hashed)
            about = Stored(
                hashed,
                identity,
                labels,
                outcome.status,
                outcome.reason,
                environment={
                    "machine": self.machine,
                    "python": "3.11.2",
                    "versions": {"torch": "2.0", "mitsuba": "3.0"},
                    "device": "cpu",
                },
                started="2024-01-01T00:00:00+00:00",
                seconds=1.0,
            )
            write.save(store, about, outcome)
        return {"trial": hashed, "identity": identity, "fit": "", **labels}

    def _outcome(self, measure: str, material: str, method: str, seed: int, hashed: str) -> Outcome:
        for key, (status, reason) in self.fail.items():
            pairs = zip(key, (measure, method, material), strict=True)
            if all(k is None or k == v for k, v in pairs):
                return Outcome(status=status, reason=reason)
        random = np.random.default_rng(int(hashed[:8], 16))
        hardness = 1.0 + 0.6 * (sum(map(ord, material)) % 7)
        excess, nanoseconds = METHODS.get(method, (method, 4.0, 200.0))[1:]
        chi2 = (excess - 1.0) * hardness / 4 * np.exp(0.25 * random.standard_normal())
        variance = 0.02 * (1 + chi2)
        builder = getattr(self, "_" + measure.replace("-", "_"))
        return builder(random, chi2, variance, nanoseconds * 1e-9, material, method)

    def _fit(self, random, chi2, variance, seconds, material, method) -> Outcome:
        fitted = method not in ("cosine", "native")
        return Outcome(
            records=[
                Record("fit-seconds", 12.0 * random.random() if fitted else 2e-5, unit="s"),
                Record("data-seconds", 0.5, unit="s"),
                Record("optimise-seconds", 1.5, unit="s"),
                Record("load-seconds", 0.05 + 0.01 * random.random(), unit="s"),
                Record("parameters", 18432.0 if fitted else 0.0, unit="1"),
                Record("size-bytes", 73728.0 if fitted else 0.0, unit="B"),
            ]
        )

    def _pdf(self, random, chi2, variance, seconds, material, method) -> Outcome:
        kl = 0.3 * np.log1p(chi2)
        records = [
            Record("kl", kl, kl * 0.93, kl * 1.08, "nats"),
            Record("chi2", chi2, chi2 * 0.9, chi2 * 1.15, "1"),
            Record("chi2-median", chi2 * 0.8, unit="1"),
            Record("mse", chi2 / 50, chi2 / 60, chi2 / 40, "1"),
            Record("invalid-share", 0.0 if method == "cosine" else 0.013, unit="1"),
            Record("lost-share", 0.0, 0.0, 0.0, "1"),
        ]
        return Outcome(records=records, arrays={"kl": np.full(64, kl), "chi2": np.full(64, chi2)})

    def _equal_spp(self, random, chi2, variance, seconds, material, method) -> Outcome:
        p = self.bias.get((method, material), 0.05 + 0.9 * random.random())
        image = self._sphere(material) + 0.002 * random.standard_normal((self.size, self.size, 3))
        records = [
            Record("variance", variance, 0.96 * variance, 1.05 * variance, "radiance^2"),
            Record("relative-variance", 9 * variance, 8.6 * variance, 9.5 * variance, "1"),
            Record("spp", 768.0, unit="1"),
            Record("bias-z", 12.3 if p < 0.01 else 0.4, unit="1"),
            Record("bias-p", p, unit="1"),
            Record("first-bias-p", 1e-9 if p < 0.01 else p, unit="1"),
        ]
        arrays = {"batch_variance": np.full(12, variance)}
        return Outcome(records=records, arrays=arrays, images={"mean": np.maximum(image, 0)})

    def _pictures(self, random, chi2, variance, seconds, material, method) -> Outcome:
        """Of twice the size that the renders have which are timed."""
        image = np.kron(self._sphere(material), np.ones((2, 2, 1)))
        images = {"picture": np.maximum(image + 0.01 * random.standard_normal(image.shape), 0)}
        if method == "improved-baseline":
            images["reference"] = image
        arrays = {
            "chunk_spp": np.array([4, 3]),
            "chunk_seconds": np.array([0.2, 0.2]),
            "variance": np.array(variance),
            "squared_mean": np.array(0.1),
            "mask": np.ones(image.shape[:2], bool),
        }
        records = [
            Record("spp-achieved", 7.0, unit="1"),
            Record("relative-mse", variance / 7 / 0.1, unit="1"),
        ]
        return Outcome(records=records, arrays=arrays, images=images)

    def _equal_time(self, random, chi2, variance, seconds, material, method) -> Outcome:
        pixels = self.size**2
        rounds = seconds * pixels * (1 + 0.03 * random.random(self.rounds))
        spp = max(1, int(2e-6 / seconds))
        hardness = 1.0 + 0.6 * (sum(map(ord, material)) % 7)
        base = 130e-9 * 0.02 * (1 + hardness)
        factor = base / (seconds * variance)
        same = method == "improved-baseline"
        speed = (1.0, 1.0, 1.0) if same else (factor, factor * 0.94, factor * 1.07)
        noise = random.standard_normal((self.size, self.size, 1)) * np.sqrt(variance / spp)
        image = np.maximum(self._sphere(material) * (1 + 3 * noise), 0)
        middle = float(np.median(rounds))
        records = [
            Record("seconds-per-spp", middle, 0.99 * middle, 1.015 * middle, "s"),
            Record("samples-per-second", pixels / middle, unit="1/s"),
            Record("spp-achieved", float(spp), unit="1"),
            Record("deadline-seconds", 1.0, unit="s"),
            Record("mse-at-deadline", variance / spp, unit="radiance^2"),
            Record("speedup-equal-time", *speed, "1"),
            Record("speedup-equal-spp", *(s * seconds / 130e-9 for s in speed), "1"),
        ]
        arrays = {"seconds": rounds, "baseline_seconds": rounds}
        return Outcome(records=records, arrays=arrays, images={"equal_time": image})

    def _cost(self, random, chi2, variance, seconds, material, method) -> Outcome:
        """In ten processes, or in twelve for the first material."""
        processes = 12 if material == self.materials[0] else 10
        middle = seconds * self.size**2
        share = 1 - 80e-9 / seconds
        parts = {"sampling": share, "material": 0.2 * (1 - share), "rest": 0.8 * (1 - share)}
        records = [Record("seconds-per-spp", middle, 0.98 * middle, 1.02 * middle, "s")]
        for part, of_it in parts.items():
            records.append(Record(f"{part}-share", of_it, 0.9 * of_it, 1.1 * of_it, "1"))
            spent = of_it * middle
            records.append(Record(f"{part}-seconds-per-spp", spent, 0.9 * spent, 1.1 * spent, "s"))
        records += [
            Record("seconds-per-million-samples", seconds * 1e6, unit="s"),
            Record("disturbed", float(method == "two-lobe"), unit="1"),
        ]
        one = {"seconds": np.full(8, middle)}
        return Outcome(records=records, arrays=together([one] * processes))

    def _convergence(self, random, chi2, variance, seconds, material, method) -> Outcome:
        spp = 2.0 ** np.arange(8)
        mse = variance / spp * np.exp(0.06 * random.standard_normal(8))
        mse[-1] -= 0.9 * mse[-1] if method == "cosine" else 0.0
        spread = 0.06 * mse
        if method == "tabulated":
            mse[-1], spread[-1] = -1e-6, 1e-5  # below the noise of the reference
        arrays = {
            "spp": spp,
            "all_seconds": np.repeat((spp * seconds * self.size**2)[:, None], 4, 1),
            "errors": mse[:, None] + spread[:, None] * np.array([-1.0, -0.5, 0.5, 1.0]),
        }
        return Outcome(records=[Record("slope", -1.0, -1.05, -0.95, "1")], arrays=arrays)

    def _slices(self, random, chi2, variance, seconds, material, method) -> Outcome:
        side, count = 64, 3
        axis = (np.arange(side) + 0.5) * 2 / side - 1
        x, y = np.meshgrid(axis, axis, indexing="xy")
        inside = x**2 + y**2 < 1
        target, pdf = [], []
        for k in range(count):
            at, wide = (0.3 * k - 0.4, 0.1 + 0.2 * k), 0.02 + 0.05 * (len(material) % 4)
            lobe = np.exp(-((x - at[0]) ** 2 + 3 * (y - at[1]) ** 2) / wide) + 0.05
            flat = np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (wide * (1 + chi2 / 9))) + 0.05
            for density, found in ((lobe, target), (flat, pdf)):
                mass = density[inside].sum() * (2 / side) ** 2
                found.append(np.where(inside, density / mass, np.nan))
        arrays = {
            "target": np.array(target, np.float32),
            "pdf": np.array(pdf, np.float32),
        }
        return Outcome(records=[Record("kl-mean", 0.3, unit="nats")], arrays=arrays)

    def _sphere(self, material: str) -> np.ndarray:
        axis = (np.arange(self.size) + 0.5) * 2 / self.size - 1
        x, y = np.meshgrid(axis, -axis, indexing="xy")
        inside = x**2 + y**2 < 0.8
        z = np.sqrt(np.maximum(0.8 - x**2 - y**2, 0))  # a point off the sphere has no height
        light = 0.08 + 0.5 * np.maximum(z + 0.5 * x, 0)
        light += 2.5 * np.exp(-((x - 0.3) ** 2 + (y - 0.4) ** 2) / 0.02)
        hue = np.array([0.9, 0.6, 0.4]) if len(material) % 2 else np.array([0.4, 0.6, 0.8])
        shown = light[..., None] * hue
        return np.where(inside[..., None], shown, 0.12)
