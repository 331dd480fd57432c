"""What accuracy costs: time per sample and per render, its parts, memory, and what was asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import BudgetExceeded
from harness.core.record import Record
from harness.measures.adapter_smoke_test import state_of
from harness.measures.base import Job, Measure, Outcome
from harness.measures.cold_start import Cold, start_cold
from harness.measures.images import checked, too_slow
from harness.measures.renders import Entrant, RenderSettings, enter
from harness.measures.throughput import Batch, BatchSettings, prepare_batch, rows_of
from harness.measures.timing import Contender, Timings, interleave
from harness.rendering.meter import PARTS, Meter, metered
from harness.stats.intervals import Interval, mean_interval, median_interval

_EACH = 4
"""Contenders of one method: sample, pdf, bare render, metered render."""
_FIT = {
    "fit-seconds": "fit-seconds",
    "data-seconds": "fit-data-seconds",
    "optimise-seconds": "fit-optimise-seconds",
    "bake-seconds": "fit-bake-seconds",
}
"""Metrics of the measure ``fit`` and what they are called here."""


class Cost(Measure):
    """Seconds, bytes and counts of each method on one material, in one scene.

    *Seconds* per million samples and pdf queries come from one batch, as ``throughput`` takes
    them; those per sample per pixel from renders that fill a slice, in rounds that all
    methods share; ratios to the baseline are of the same turn, in which the two alternate.

    *Parts*: in a metered render (:class:`~harness.rendering.meter.Meter`) every call of the
    method and of the material is forced by itself. ``sampling-share`` is the method's sample
    and pdf, ``material-share`` the material's evaluation, ``rest-share`` everything else; each
    over the metered render's own time. Seconds per spp of a part are its share times the bare
    render's seconds of the same turn. ``metering-overhead`` is metered over bare less one:
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
        """``starts`` cold starts, in the first sitting; 0 leaves out load, compile and peak."""

        rounds: int = 12
        starts: int = 3

    own_times: ClassVar[tuple[str, ...]] = (
        "seconds-per-million-samples",
        "seconds-per-million-pdf",
        "seconds-per-spp",
    )

    @classmethod
    def later_sittings(cls, first: Outcome) -> dict[str, Any]:
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
            cold = None
            if settings.starts:
                notify(f"{subject.job.method.name}: cold starts")
                cold = subject.cold(settings.starts)
            outcomes.append(subject.outcome(timings, _EACH * i, cold))
        return outcomes


@dataclass
class _Subject:
    """One method: its batch, its renders, and a meter for every metered render."""

    job: Job
    batch: Batch
    bare: Entrant
    meters: dict[int, tuple[float, Meter]] = field(default_factory=dict)
    """By round: seconds of the metered render, and what the meter says."""

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
        self.meters[number] = rendered.seconds, meter
        return rendered.seconds

    def cold(self, starts: int) -> Cold:
        """In a fresh process."""
        trial = self.job.trial
        return start_cold(
            trial.method_name,
            trial.params,
            trial.material_spec,
            state_of(self.job.method),
            self.job.budget.device,
            self.batch.rows,
            starts,
        )

    def outcome(self, timings: Timings, first: int, cold: Cold | None) -> Outcome:
        """Everything that is known in the end."""
        sample, pdf, bare, metering = range(first, first + _EACH)
        shares = self._shares()
        mark, reason = timings.mark(sample, pdf, bare, metering)
        records = [
            Record("batch", float(self.batch.rows), unit="1"),
            Record("seconds-per-million-samples", *_times(timings.median(sample), 1e6), "s"),
            Record("seconds-per-million-pdf", *_times(timings.median(pdf), 1e6), "s"),
            Record("sample-time-ratio", *timings.ratio(sample), "1"),
            Record("pdf-time-ratio", *timings.ratio(pdf), "1"),
            Record("seconds-per-spp", *timings.median(bare), "s"),
            Record("time-ratio", *timings.ratio(bare), "1"),
        ]
        # Of the renders that alternated with the metered ones.
        same_turn = timings.rival_seconds(metering)
        for part, share in shares.items():
            records.append(Record(f"{part}-share", *median_interval(share), "1"))
            seconds = median_interval(share * same_turn)
            records.append(Record(f"{part}-seconds-per-spp", *seconds, "s"))
        over = timings.ratio(metering)
        records += [
            Record("metering-overhead", *(v - 1 for v in over), "1"),
            Record("measuring-overhead", timings.overhead(), unit="1"),
        ]
        counts = self._counts()
        records += [Record(key, *mean_interval(value), "1/spp") for key, value in counts.items()]
        records += [
            Record(name, self.job.fit_records[metric], unit="s")
            for metric, name in _FIT.items()
            if metric in self.job.fit_records
        ]
        arrays = {
            "sample_seconds": timings.seconds(sample) * self.batch.rows,
            "pdf_seconds": timings.seconds(pdf) * self.batch.rows,
            "seconds": timings.seconds(bare),
            "batch_variance": np.array(self.bare.errors),
            "baseline_seconds": timings.rival_seconds(bare),
            "metered_seconds": timings.seconds(metering),
            "bare_of_metered_seconds": same_turn,
            "round_spp": np.array(self.bare.spp),
            "loadavg": timings.loadavg,
            **{f"{part}_share": share for part, share in shares.items()},
        }
        if cold is not None:
            told, arrays["load_seconds"], arrays["compile_seconds"] = _cold_records(cold)
            records += told
            reason = "; ".join(filter(None, [reason, cold.no_peak]))
        return Outcome(reason=reason, records=[*records, mark], arrays=arrays)

    def _shares(self) -> dict[str, NDArray]:
        """Of the metered renders [rounds]: the method's part, the material's, and the rest."""
        found = [self.meters[number] for number in sorted(self.meters)]
        spent = {
            part: np.array([meter.parts[part].seconds / total for total, meter in found])
            for part in PARTS
        }
        sampling = spent["sample"] + spent["pdf"]
        return {
            "sampling": sampling,
            "material": spent["eval"],
            "rest": 1 - sampling - spent["eval"],
        }

    def _counts(self) -> dict[str, NDArray]:
        """Per sample per pixel [rounds]."""
        meters = [self.meters[number][1] for number in sorted(self.meters)]
        spp, pixels = self.bare.spp, self.bare.prepared.mask.size
        found = {
            "rays": [pixels + m.directions / spp for m in meters],
            "shading-points": [m.points / spp for m in meters],
        }
        for part in PARTS:
            found[f"{part}-calls"] = [m.parts[part].calls / spp for m in meters]
            found[f"{part}-rows"] = [m.parts[part].rows / spp for m in meters]
        return {key: np.array(value) for key, value in found.items()}


def _cold_records(cold: Cold) -> tuple[list[Record], NDArray, NDArray]:
    load, compiling = np.array(cold.load), np.array(cold.compile)
    records = [
        Record("load-seconds", *median_interval(load), "s"),
        Record("compile-seconds", *median_interval(compiling), "s"),
        Record("size-bytes", float(cold.size), unit="B"),
    ]
    if cold.peak is not None:
        records.append(Record("peak-bytes", float(cold.peak), unit="B"))
    return records, load, compiling


def _times(interval: Interval, factor: float) -> Interval:
    return Interval(*(factor * v for v in interval))
