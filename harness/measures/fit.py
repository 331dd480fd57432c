"""The measure that all others need: fit a method, keep its state, say what that took."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch

from harness.core.protocol.errors import Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import FitReport, Method
from harness.measures.adapter_smoke_test import BadAdapter, guard, state_of
from harness.measures.base import Job, Measure, Outcome, Record
from harness.measures.timing import now
from harness.stats.intervals import Interval, mean_interval


class Fit(Measure):
    """Seconds of fitting and of loading, and the size of what was fitted.

    ``fit-seconds`` is the whole of ``method.fit``; ``data-seconds``, ``optimise-seconds`` and,
    for a method that bakes, ``bake-seconds`` are its parts as the method reports them. Targets
    that were tabulated for another method of the run count with the time that took.
    Their intervals are of the optimisation alone: what the total would be if its parts were
    drawn anew from those seen. ``load-seconds`` is what a renderer waits for: from the state in
    memory to the first sample of a new method, so that a compilation counts here and never in
    a steady-state figure.
    """

    name = "fit"
    needs_scene = False
    machine_bound = True

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`; ``job.method`` is not fitted yet."""
        return [self._one(job) for job in jobs]

    def _one(self, job: Job) -> Outcome:
        method, material, device = job.method, job.material, job.budget.device
        supported, reason = method.supports(material)
        if not supported:
            raise Unsupported(reason or f"{method.name} does not support {material.name}")
        start = now(device)
        report = method.fit(material, job.budget, job.generator)
        elapsed = now(device) - start
        if not isinstance(report, FitReport):
            kind = type(report).__name__
            raise BadAdapter(f"{method.name}: fit returned a {kind}, expected a FitReport")
        # Targets shared with an earlier fit took no time now, but a fit alone would make them.
        parts = report.data_seconds + report.optimise_seconds + report.bake_seconds
        fit_seconds = max(elapsed, parts)
        state = {key: value.detach() for key, value in state_of(method).items()}
        start = now(device)
        loaded = restore(job.make(), material, state)
        condition = material.conditions(1, job.generator, device)
        with torch.inference_mode():
            loaded.sample(condition, torch.rand(1, 3, generator=job.generator).to(device))
        load_seconds = now(device) - start
        guard(loaded, material, job.generator, device)
        records = [
            Record("fit-seconds", *_steady(fit_seconds, report.part_seconds), "s"),
            Record("data-seconds", report.data_seconds, unit="s"),
            Record("optimise-seconds", *_steady(report.optimise_seconds, report.part_seconds), "s"),
            Record("load-seconds", load_seconds, unit="s"),
            Record("parameters", report.parameters, unit="1"),
            Record("size-bytes", method.size_bytes(), unit="B"),
        ]
        if report.bake_seconds:
            records.append(Record("bake-seconds", report.bake_seconds, unit="s"))
        if report.loss:
            records.append(Record("final-loss", report.loss[-1], unit="1"))
        arrays = {
            name: torch.tensor(values).numpy()
            for name, values in (("loss", report.loss), ("part_seconds", report.part_seconds))
            if values
        }
        return Outcome(records=records, arrays=arrays, tensors=state)


def _steady(total: float, parts: list[float]) -> Interval:
    """``total`` seconds, and how far the sum of ``parts`` of it is sure."""
    if len(parts) < 2:
        return Interval(total, math.nan, math.nan)
    mean = mean_interval(parts)
    low, high = (len(parts) * (end - mean.value) for end in (mean.low, mean.high))
    return Interval(total, total + low, total + high)


def restore(method: Method, material: Material, state: dict[str, torch.Tensor]) -> Method:
    """``method``, newly made, bound to ``material`` and with ``state`` loaded."""
    method.bind(material)
    method.load_state_dict(state)
    return method
