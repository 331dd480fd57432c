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


def minimise(
    module: nn.Module,
    loss: Callable[[], Tensor],
    targets: Targets,
    budget: Budget,
    *,
    learning_rate: float = 5e-4,
    weight_decay: float = 1e-5,
) -> FitReport:
    """Adam on ``loss()``, one batch a call, for ``budget.steps`` steps.

    The step size follows one cosine from ``learning_rate`` down to nothing, after a short
    linear rise. A loss that is not finite ends the fit with an error that says where; no
    batch is skipped.

    Raises:
        FloatingPointError: the loss became nan or infinite.
        BudgetExceeded: ``budget.max_seconds`` passed first.
    """
    start = time.perf_counter()
    module.to(budget.device).train()
    optimiser = torch.optim.Adam(
        module.parameters(), learning_rate, weight_decay=weight_decay, fused=True
    )
    rise = max(1, budget.steps // 20)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimiser,
        lambda step: min(
            (step + 1) / rise, 0.5 * (1 + math.cos(math.pi * step / max(1, budget.steps)))
        ),
    )
    history: list[float] = []
    every = max(1, budget.steps // 100)
    part = budget.steps // PARTS
    marks: list[float] = []
    for step in range(budget.steps):
        if part and step % part == 0 and len(marks) <= PARTS:
            marks.append(_now(budget.device))
        value = loss()
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        optimiser.step()
        schedule.step()
        if step % every == 0 or step == budget.steps - 1:
            history.append(float(value.detach()))
            if not math.isfinite(history[-1]):
                raise FloatingPointError(f"loss is {history[-1]} at step {step}")
            if time.perf_counter() - start > budget.max_seconds:
                raise BudgetExceeded(
                    f"fit passed its limit of {budget.max_seconds:g} s at step {step}"
                    f" of {budget.steps}"
                )
    if part and budget.steps == PARTS * part:
        marks.append(_now(budget.device))
    module.eval()
    return FitReport(
        steps=budget.steps,
        parameters=count_parameters(module),
        data_seconds=targets.seconds,
        optimise_seconds=time.perf_counter() - start,
        loss=history,
        part_seconds=[end - begin for begin, end in itertools.pairwise(marks)],
        notes=targets.notes,
    )


def _now(device: str) -> float:
    if device != "cpu":
        torch.cuda.synchronize(device)
    return time.perf_counter()
