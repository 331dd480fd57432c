"""Gradients are finite: while a method is fitted, and of its log density in hard places."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.optimizer import Optimizer, register_optimizer_step_pre_hook

from harness.checks.finding import Finding, rounded
from harness.checks.subject import Case, Subject
from harness.core.protocol.method import Method
from harness.fitting.module_method import ModuleMethod

TESTS = 0

RIM = (0.999, 0.9999, 0.999999)
EDGES = 16
"""Halves of this many bins per unit: the knots and cell edges of most tables."""


@dataclass
class GradientWatch:
    """What :func:`watched_gradients` saw: optimiser steps, and the first bad gradient."""

    steps: int = 0
    bad_step: int | None = None
    parameter: Tensor | None = None
    share: float = 0.0
    seen: set[int] = field(default_factory=set)

    def look(self, optimiser: Optimizer) -> None:
        """Count a step, and look at every gradient it is about to use."""
        if self.bad_step is None:
            for group in optimiser.param_groups:
                for parameter in group["params"]:
                    self._look_at(parameter)
        self.steps += 1

    def _look_at(self, parameter: Tensor) -> None:
        if parameter.grad is None or self.bad_step is not None:
            return
        self.seen.add(id(parameter))
        finite = parameter.grad.detach().isfinite()
        if not bool(finite.all()):
            self.bad_step, self.parameter = self.steps, parameter
            self.share = 1 - float(finite.double().mean())

    def finding(self, method: Method) -> Finding:
        """Of property ``gradients``, case ``fit``; ``method`` is asked for the parameter's name."""
        if self.bad_step is not None and self.parameter is not None:
            shape = tuple(self.parameter.shape)
            text = (
                f"{self.share:.0%} of the gradient of {_name(method, self.parameter)} {shape}"
                f" is not finite at step {self.bad_step} of the fit"
            )
            return Finding("gradients", "fit", "fail", text, {"step": self.bad_step})
        if not self.seen:
            return Finding("gradients", "fit", "skip", "no optimiser of torch made a step")
        text = f"finite in {self.steps} steps, {len(self.seen)} tensors"
        return Finding("gradients", "fit", "pass", text)


@contextmanager
def watched_gradients() -> Iterator[GradientWatch]:
    """Watch every torch optimiser that takes a step inside, whoever made it."""
    watch = GradientWatch()

    def hook(optimiser: Optimizer, args: Any, kwargs: Any) -> None:
        watch.look(optimiser)

    handle = register_optimizer_step_pre_hook(hook)
    try:
        yield watch
    finally:
        handle.remove()


def check_gradients(subject: Subject, case: Case) -> Finding:
    """Gradients of ``log_prob`` (parameters and ``wo``) at the rim, the centre and on edges.

    Only where the density is positive: the logarithm of nothing has no gradient.
    """
    name, method = "gradients", subject.method
    if not isinstance(method, ModuleMethod):
        return Finding(name, case.name, "skip", "no module with a log_prob")
    wo = hard_directions(case).to(subject.device)
    parameters = [p for p in method.module.parameters() if p.requires_grad]
    with torch.enable_grad():
        leaf = wo.clone().requires_grad_()
        try:
            log = method.log_prob(case.row[None], leaf[None])[0]
        except NotImplementedError:
            return Finding(name, case.name, "skip", "log_prob is not written; its loss is its own")
        if not log.requires_grad:
            return Finding(name, case.name, "skip", "log_prob gives no gradients; the fit's are")
        bad = log.isnan() | (log == math.inf)
        if bool(bad.any()):
            return _bad(case, wo, log, bad, "log_prob")
        lit = log.detach().isfinite().nonzero()[:, 0]
        first = _gradients(log[lit].sum(), [leaf, *parameters])
        if all(bool(g.isfinite().all()) for g in first):
            text = f"of log_prob finite at {len(lit)} of {len(wo)} directions"
            return Finding(name, case.name, "pass", text)
        # Only now one direction at a time, to name the worst.
        bad = torch.zeros_like(bad)
        for k in lit.tolist():
            grads = _gradients(method.log_prob(case.row[None], leaf[k][None, None]).sum(), [leaf])
            own = _gradients(
                method.log_prob(case.row[None], leaf.detach()[k][None, None]).sum(), parameters
            )
            bad[k] = not all(bool(g.isfinite().all()) for g in [*grads, *own])
    if not bool(bad.any()):
        bad[lit[0]] = True
    return _bad(case, wo, log, bad, "gradient of log_prob")


def hard_directions(case: Case) -> Tensor:
    """Directions [D, 2] inside the disk: centre, axes, rim, mirror, and edges of dyadic cells."""
    turn = torch.arange(8) * (math.pi / 4) + 0.1
    circle = torch.stack([turn.cos(), turn.sin()], -1)
    axes = torch.tensor([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [-0.25, 0.0], [0.0, -0.25]])
    step = torch.arange(-EDGES + 1, EDGES) / EDGES
    diagonal = torch.stack([step, step.flip(0) * 0.5], -1)
    mirror = -case.row[-2:].cpu()[None]
    tenth = torch.stack([step.sign() * 0.1, torch.arange(-EDGES + 1, EDGES) / 20], -1)
    wo = torch.cat([axes, *(r * circle for r in RIM), diagonal, tenth, mirror, mirror * 0.999])
    return wo[wo.square().sum(-1) < 1]


def _gradients(value: Tensor, leaves: list[Tensor]) -> list[Tensor]:
    found = torch.autograd.grad(value, leaves, allow_unused=True, retain_graph=True)
    return [g for g in found if g is not None]


def _bad(case: Case, wo: Tensor, log: Tensor, bad: Tensor, what: str) -> Finding:
    k = int(bad.nonzero()[0, 0])
    text = f"{what} is not finite at {int(bad.sum())} of {len(wo)} directions"
    worst = {
        "condition": rounded(case.row),
        "wo": rounded(wo[k]),
        "got": f"log density {rounded(log[k])}",
        "expected": "a finite gradient",
    }
    return Finding("gradients", case.name, "fail", text, worst)


def _name(method: Method, parameter: Tensor) -> str:
    """Name of ``parameter`` in whatever module the method keeps it."""
    for attribute, value in vars(method).items():
        if isinstance(value, nn.Module):
            for name, other in value.named_parameters(attribute):
                if other is parameter:
                    return name
    return "a parameter"
