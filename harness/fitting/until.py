"""Fits of ever more steps, until the density gets no better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch

from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Method
from harness.fitting.targets import Targets

DOUBLINGS = 7
"""At most: 128 times the steps of the budget."""
CONDITIONS = 128
"""Held out from fitting, always the same ones."""
_SEED = 20_000_003
"""Of the conditions: no seed of a suite's streams."""


def fit_until(
    make: Callable[[], Method], material: Material, budget: Budget, generator: torch.Generator
) -> tuple[Method, FitReport]:
    """The first fit whose KL differs by less than ``budget.until`` from that of half its steps.

    Every fit is a new one, made by ``make``, with its whole schedule and the same random numbers.
    The report is that of the last, but for its seconds, which are those of all, and for
    ``validation``, the steps and KL of each.

    Raises:
        BudgetExceeded: KL still moves after ``DOUBLINGS`` doublings, or the time is over.
    """
    held_out, state = Validation(material, budget.device), generator.get_state()
    validation: list[tuple[int, float]] = []
    data = seconds = 0.0
    for doubling in range(DOUBLINGS + 1):
        generator.set_state(state)
        method, steps = make(), budget.steps << doubling
        method.bind(material)
        left = replace(
            budget, steps=steps, until=None, max_seconds=budget.max_seconds - data - seconds
        )
        report = method.fit(material, left, generator)
        data = max(data, report.data_seconds)
        seconds += report.optimise_seconds + report.bake_seconds
        validation.append((steps, held_out.kl(method)))
        before, now = validation[-2:][0][1], validation[-1][1]
        if report.steps == 0 or (doubling and abs(before - now) <= budget.until * abs(now)):
            # The parts are those of the last fit alone, and say nothing of the sum.
            return method, replace(
                report, optimise_seconds=seconds, bake_seconds=0.0, data_seconds=data,
                part_seconds=[], validation=validation,
            )  # fmt: skip
    raise BudgetExceeded(
        f"KL still moves by {abs(before - now) / abs(now):.1%} from {steps // 2} to {steps} steps;"
        f" expected less than {budget.until:.1%}"
    )


class Validation:
    """Conditions that no fit sees, and directions of their p*."""

    def __init__(self, material: Material, device: str = "cpu", conditions: int = CONDITIONS):
        generator = torch.Generator().manual_seed(_SEED)
        self.targets = Targets.build(material, Budget(pool=conditions, device=device), generator)

    @torch.no_grad()
    def kl(self, method: Method) -> float:
        """Mean of KL(p* || p) over the conditions, in nats; infinite where p = 0 < p*."""
        targets = self.targets
        count = targets.wo.shape[1]
        rows = targets.condition.repeat_interleave(count, 0)
        pdf = method.pdf(rows, targets.wo.reshape(-1, 2)).view(-1, count).double()
        density, mass = targets.density.double(), targets.mass.double()
        # p* log p* is 0 at p* = 0 by continuity, whatever p is there.
        terms = torch.where(mass > 0, mass * (density.log() - pdf.log()), 0)
        return float(terms.sum(1).mean())
