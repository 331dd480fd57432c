"""One training loop for all fitted methods."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable

import torch
from torch import Tensor, nn

from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.method import Budget, FitReport
from harness.fitting.targets import Targets
from harness.nets.mlp import count_parameters

PARTS = 12
"""Parts of a fit whose times are told apart: enough for an interval, each long enough that the
parts of a slow spell count as one."""
EVERY = 10
"""Steps between two looks at the loss of a fit that is limited by time."""


def minimise(
    module: nn.Module,
    loss: Callable[[], Tensor],
    targets: Targets,
    budget: Budget,
    *,
    learning_rate: float = 5e-4,
    weight_decay: float = 1e-5,
) -> FitReport:
    """Adam on ``loss()``, one batch a call, for ``budget.steps`` steps or ``budget.seconds``.

    The step size follows one cosine from ``learning_rate`` down to nothing, after a short
    linear rise, over the steps or over the time. A loss that is not finite ends the fit with an
    error that says where; no batch is skipped.

    Raises:
        FloatingPointError: the loss became nan or infinite.
        BudgetExceeded: ``budget.max_seconds`` passed first.
    """
    start = time.perf_counter()
    module.to(budget.device).train()
    optimiser = torch.optim.Adam(
        module.parameters(), learning_rate, weight_decay=weight_decay, fused=True
    )
    rate = _by_steps(budget.steps) if budget.seconds is None else _by_time(budget.seconds)
    history: list[float] = []
    limited = budget.seconds is not None
    every = EVERY if limited else max(1, budget.steps // 100)
    part = 0 if limited else budget.steps // PARTS
    marks: list[float] = []
    step, scale = 0, rate(0)
    while scale is not None:
        if part and step % part == 0 and len(marks) <= PARTS:
            marks.append(_now(budget.device))
        for group in optimiser.param_groups:
            group["lr"] = learning_rate * scale
        value = loss()
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        optimiser.step()
        scale = rate(step + 1)
        if step % every == 0 or scale is None:
            history.append(float(value.detach()))
            if not math.isfinite(history[-1]):
                raise FloatingPointError(f"loss is {history[-1]} at step {step}")
            if time.perf_counter() - start > budget.max_seconds:
                of = "" if limited else f" of {budget.steps}"
                raise BudgetExceeded(
                    f"fit passed its limit of {budget.max_seconds:g} s at step {step}{of}"
                )
        step += 1
    if part and step == PARTS * part:
        marks.append(_now(budget.device))
    module.eval()
    return FitReport(
        steps=step,
        parameters=count_parameters(module),
        data_seconds=targets.seconds,
        optimise_seconds=time.perf_counter() - start,
        loss=history,
        part_seconds=[end - begin for begin, end in itertools.pairwise(marks)],
        notes=targets.notes,
    )


def _by_steps(steps: int) -> Callable[[int], float | None]:
    """Share of the step size at a step; None where there are no more."""
    rise = max(1, steps // 20)

    def rate(step: int) -> float | None:
        if step >= steps:
            return None
        return min((step + 1) / rise, 0.5 * (1 + math.cos(math.pi * step / steps)))

    return rate


def _by_time(seconds: float) -> Callable[[int], float | None]:
    """The same over ``seconds`` from now on, by a clock that is asked at every step."""
    start = time.perf_counter()

    def rate(step: int) -> float | None:
        done = (time.perf_counter() - start) / seconds
        if done >= 1:
            return None
        # The first step is taken at no time at all.
        return min((done + 1e-3) * 20, 1.0, 0.5 * (1 + math.cos(math.pi * done)))

    return rate


def _now(device: str) -> float:
    if device != "cpu":
        torch.cuda.synchronize(device)
    return time.perf_counter()
