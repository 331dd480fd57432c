"""What accuracy costs: time per sample and per render, its parts, memory, and what was asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import BudgetExceeded
from harness.measures.adapter_smoke_test import state_of
from harness.measures.base import Job, Measure, Outcome
from harness.measures.cold_start import ColdStarts, cold_starts
from harness.measures.compact import single
from harness.measures.images import checked, too_slow
from harness.measures.renders import Entrant, RenderSettings, enter
from harness.measures.throughput import (
    Batch,
    BatchSettings,
    prepare_batch,
    rows_of,
    times_of_calls,
)
from harness.measures.timing import Contender, Timings, interleave
from harness.rendering.meter import PARTS, Meter, metered

_EACH = 4
"""Contenders of one method: sample, pdf, bare render, metered render."""
_FIT = {
    "fit-seconds": "fit_seconds",
    "data-seconds": "fit_data_seconds",
    "optimise-seconds": "fit_optimise_seconds",
    "bake-seconds": "fit_bake_seconds",
}
"""Metrics of the measure ``fit`` and the arrays that keep them here."""


class Cost(Measure):
    """Seconds, bytes and counts of each method on one material, in one scene.

    *Seconds* per million samples and pdf queries come from one batch, as ``throughput`` takes
    them; those per sample per pixel from renders that fill a slice, in rounds that all
    methods share; ratios to the baseline are of the same round, in which the two alternate.

    *Parts*: in a metered render (:class:`~harness.rendering.meter.Meter`) every call of the
    method and of the material is forced by itself. ``sampling-share`` is the method's sample
    and pdf, ``material-share`` the material's evaluation, ``rest-share`` everything else; each
    over the metered render's own time. Seconds per spp of a part are its share times the bare
    render's seconds of the same round. ``metering-overhead`` is metered over bare less one:
    what the split is uncertain by. ``measuring-overhead`` is the rest of the measuring over
    the renders and calls themselves, of all methods together.

    *Counts* are per sample per pixel, taken by the plugin: ``rays`` are camera rays and those
    that go on from the material (none from other surfaces); ``shading-points`` are rays that
    hit it, on either side; calls and active rows of the method's sample and pdf, and of the
    material's evaluation.

    *Before the first sample*, in a process of its own (:mod:`harness.measures.cold_start`):
    ``load-seconds``, ``compile-seconds``, ``peak-bytes`` of one call of ``batch`` rows, and
    ``size-bytes`` of the state's file. Fit times are those that the fit recorded.
    """

    name = "cost"
    timed = True

    class Settings(BatchSettings, RenderSettings):
        """``starts`` cold starts, in the first process; 0 leaves out load, compile and peak."""

        rounds: int = 12
        starts: int = 3

    @classmethod
    def later_processes(cls, first: Outcome) -> dict[str, Any]:
        """See :class:`Measure`."""
        spp = first.arrays.get("round_spp")
        sizes = rows_of(first) | ({} if spp is None else {"spp": int(spp)})
        return sizes | {"starts": 0}

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        settings = self.Settings(**jobs[0].settings)
        # Batches first: they are small for a slow method, and have it compiled when its speed
        # is read off.
        batches = [prepare_batch(job, self.Settings(**job.settings), notify) for job in jobs]
        slow = [
            too_slow(j, settings.resolution, 4 * settings.rounds, settings.patience) for j in jobs
        ]
        ready = [
            (job, batch)
            for job, batch, reason in zip(jobs, batches, slow, strict=True)
            if not reason
        ]
        found = iter(self._timed(ready, settings, notify))
        return [Outcome("timeout", reason) if reason else next(found) for reason in slow]

    def _timed(
        self,
        ready: list[tuple[Job, Batch]],
        settings: Settings,
        notify: Callable[[str], None],
    ) -> list[Outcome]:
        base = next((i for i, (job, _) in enumerate(ready) if job.baseline), None)
        if base is None:
            raise BudgetExceeded("the baseline is too slow for its rounds")
        subjects, contenders = [], []
        for i, (job, batch) in enumerate(ready):
            own = self.Settings(**job.settings)
            subject = _Subject(job, batch, enter(job, own, notify))
            subjects.append(subject)
            contenders += subject.contenders(_EACH * i, None if i == base else _EACH * base)
        timings = interleave(contenders, settings, notify)
        outcomes = []
        for i, subject in enumerate(subjects):
            starts = None
            if settings.starts:
                notify(f"{subject.job.method.name}: cold starts")
                starts = subject.cold_starts(settings.starts)
            outcomes.append(subject.outcome(timings, _EACH * i, starts))
        return outcomes


@dataclass
class _Subject:
    """One method: its batch, its renders, and a meter for every metered render."""

    job: Job
    batch: Batch
    bare: Entrant
    meters: dict[int, Meter] = field(default_factory=dict)
    """What the meter says, by round."""

    def contenders(self, first: int, base: int | None) -> list[Contender]:
        """Sample, pdf, bare and metered render; the rival of the last is the bare one."""
        name, spp = self.job.method.name, self.bare.spp
        return [
            *self.batch.contenders(self.job, base),
            self.bare.contender(None if base is None else base + 2, slices=1),
            Contender(f"{name} metered render", self._metered, spp, first + 2, slices=1),
        ]

    def _metered(self, number: int) -> float:
        prepared, seed = self.bare.prepared, 5000 * (self.job.seed + 1) + number
        with metered(prepared.bsdf) as meter:
            rendered = checked(prepared.render(self.bare.spp, seed), self.job)
        self.meters[number] = meter
        return rendered.seconds

    def cold_starts(self, starts: int) -> ColdStarts:
        """In a fresh process."""
        trial = self.job.trial
        return cold_starts(
            trial.method_name,
            trial.params,
            trial.material_spec,
            state_of(self.job.method),
            self.job.budget.device,
            self.batch.rows,
            starts,
        )

    def outcome(self, timings: Timings, first: int, starts: ColdStarts | None) -> Outcome:
        """Everything that is known in the end."""
        bare, metering = first + 2, first + 3
        arrays = {
            **times_of_calls(timings, first, self.batch),
            "seconds": single(timings.seconds(bare)),
            "baseline_seconds": single(timings.rival_seconds(bare)),
            "batch_variance": single(self.bare.errors),
            "round_spp": np.array(self.bare.spp),
            "pixels": np.array(self.bare.prepared.mask.size),
            "metered_seconds": single(timings.seconds(metering)),
            "bare_of_metered_seconds": single(timings.rival_seconds(metering)),
            "wall_seconds": np.array(timings.wall),
            "timed_seconds": np.array(timings.timed),
            **self._metered_parts(),
        }
        for metric, name in _FIT.items():
            if metric in self.job.fit_records:
                arrays[name] = np.array(self.job.fit_records[metric])
        documents = {}
        if starts is not None:
            arrays["load_seconds"] = single(starts.load)
            arrays["compile_seconds"] = single(starts.compile)
            arrays["size_bytes"] = np.array(starts.size)
            if starts.peak is not None:
                arrays["peak_bytes"] = np.array(starts.peak)
            if starts.no_peak:
                documents["no_peak"] = starts.no_peak
        return Outcome(arrays=arrays, documents=documents)

    def _metered_parts(self) -> dict[str, NDArray]:
        """Of the metered renders [rounds]: seconds per sample per pixel of each part, and counts.

        Counts are those of a whole render.
        """
        meters = [self.meters[number] for number in sorted(self.meters)]
        found: dict[str, NDArray] = {
            "metered_directions": np.array([m.directions for m in meters]),
            "metered_points": np.array([m.points for m in meters]),
        }
        for part in PARTS:
            tallies = [m.parts[part] for m in meters]
            found[f"metered_{part}_seconds"] = single([t.seconds / self.bare.spp for t in tallies])
            found[f"metered_{part}_calls"] = np.array([t.calls for t in tallies])
            found[f"metered_{part}_rows"] = np.array([t.rows for t in tallies])
        return found
