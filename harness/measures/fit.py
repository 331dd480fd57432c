"""The measure that all others need: fit a method, keep its state, say what that took."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import torch

from harness.core.protocol.errors import Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import FitReport, Method
from harness.fitting.until import fit_until
from harness.measures.adapter_smoke_test import BadAdapter, smoke_test, state_of
from harness.measures.base import Job, Measure, Outcome
from harness.measures.compact import single
from harness.measures.timing import now


class Fit(Measure):
    """Seconds of fitting and of loading, and the size of what was fitted.

    ``fit-seconds`` is the whole of ``method.fit``; ``data-seconds``, ``optimise-seconds`` and,
    for a method that bakes, ``bake-seconds`` are its parts as the method reports them. Targets
    that were tabulated for another method of the run count with the time that took.
    Their intervals are of the optimisation alone: what the total would be if its parts were
    drawn anew from those seen. ``load-seconds`` is what a renderer waits for: from the state in
    memory to the first sample of a new method, so that a compilation counts here and never in
    a steady-state figure. ``steps``: of a fit that was limited by time or went on until it was
    converged; then ``kl-moved`` is the last relative change of KL when the steps were doubled.
    ``cpu-seconds``, on a CPU, is the processor time of all threads and finished child processes
    in ``method.fit``; a fit that had to wait for a processor took longer than it would alone, and
    is marked as disturbed.
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
        start, worked = now(device), _processor_seconds()
        if job.budget.until is None:
            report = method.fit(material, job.budget, job.generator)
        else:
            method, report = fit_until(job.make, material, job.budget, job.generator)
        elapsed, worked = now(device) - start, _processor_seconds() - worked
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
        smoke_test(loaded, material, job.generator, device)
        found = {
            "fit_seconds": fit_seconds,
            "data_seconds": report.data_seconds,
            "optimise_seconds": report.optimise_seconds,
            "bake_seconds": report.bake_seconds,
            "load_seconds": load_seconds,
            "parameters": report.parameters,
            "size_bytes": method.size_bytes(),
        }
        if device == "cpu":
            found |= {"elapsed_seconds": elapsed, "cpu_seconds": worked}
        arrays = {name: np.array(float(value)) for name, value in found.items()}
        for name, values in (("loss", report.loss), ("part_seconds", report.part_seconds)):
            if values:
                arrays[name] = single(values)
        if job.budget.until or job.budget.seconds:
            arrays["steps"] = np.array(float(report.steps))
        if report.validation:
            arrays["validation"] = np.array(report.validation)
        return Outcome(arrays=arrays, tensors=state)


def _processor_seconds() -> float:
    """Of this process, all its threads, and its children that have ended (a bake has some)."""
    return sum(os.times()[:4])


def restore(method: Method, material: Material, state: dict[str, torch.Tensor]) -> Method:
    """``method``, newly made, bound to ``material`` and with ``state`` loaded."""
    method.bind(material)
    method.load_state_dict(state)
    return method
