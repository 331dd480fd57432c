"""The best form of each method at equal fitting seconds, by one random search for all alike."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import torch

from harness.core import registry
from harness.core.protocol.errors import BudgetExceeded, InputError, Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, Method
from harness.fitting.until import Validation
from harness.suite.trials import FIT, Trial, stream_seed

APART = ("precision",)
"""Knobs that change a method's size alone."""
ATTEMPTS = 100
"""Draws without a new form after which all of a small space are taken for seen."""


@dataclass
class Tried:
    """One form of a method: its KL, seconds and steps by material, or why it has none."""

    params: dict[str, Any]
    kl: dict[str, float] = field(default_factory=dict)
    steps: dict[str, int] = field(default_factory=dict)
    failed: str = ""

    @property
    def score(self) -> float:
        """Mean over materials of the logarithm of KL: lower is better; infinite if it failed."""
        if self.failed or not self.kl:
            return math.inf
        return sum(math.log(max(kl, 1e-12)) for kl in self.kl.values()) / len(self.kl)

    def as_data(self) -> dict[str, Any]:
        """As it is written."""
        if self.failed:
            return {"params": self.params, "failed": self.failed}
        return {"params": self.params, "kl": self.kl, "steps": self.steps}


def space(kind: type[Method]) -> dict[str, tuple[Any, ...]]:
    """Every parameter that is searched, with its values: a method's knobs and its forms.

    Forms are what its file has under ``FORMS``: parameters with values of which each may be the
    best somewhere, the default among them.
    """
    knobs = {k.name: k.values for k in kind.knobs if "." not in k.name and k.name not in APART}
    return {**knobs, **getattr(sys.modules[kind.__module__], "FORMS", {})}


def forms(name: str, own: dict[str, Any], count: int, seed: int) -> Iterator[dict[str, Any]]:
    """``count`` different forms: ``own`` first, then each other parameter drawn at random.

    Fewer where a method has fewer.
    """
    kind, rng = registry.load(name), random.Random(seed)
    values = {key: options for key, options in space(kind).items() if key not in own}
    seen = [own]
    yield own
    for _ in range(ATTEMPTS * count if values else 0):
        if len(seen) == count:
            return
        drawn = {**own, **{key: rng.choice(options) for key, options in values.items()}}
        if drawn not in seen:
            seen.append(drawn)
            yield drawn


def tune(
    fits: list[Trial],
    material_of: Callable[[Trial], Material],
    trials: int,
    seconds: float,
    notify: Callable[[str], None],
) -> dict[str, list[Tried]]:
    """By method: the forms tried on the materials of ``fits``, the best first.

    ``fits`` are the trials of one training seed. Every form of every method is fitted for
    ``seconds`` from the same random numbers, and judged by KL(p* || p) on the same conditions,
    which no fit sees.
    """
    found: dict[str, list[Tried]] = {}
    held_out: dict[str, Validation] = {}
    for method in dict.fromkeys(trial.method for trial in fits):
        mine = [trial for trial in fits if trial.method == method]
        first = mine[0]
        if registry.load(first.method_name).fit is Method.fit:
            continue  # nothing is fitted
        tried = [Tried(p) for p in forms(first.method_name, first.params, trials, first.seed)]
        for one in tried:
            for trial in mine:
                material = material_of(trial)
                if trial.material not in held_out:
                    held_out[trial.material] = Validation(material, trial.budget.device)
                _try(one, trial, material, held_out[trial.material], seconds)
            said = one.failed or f"KL {math.exp(one.score):.4g}"
            notify(f"{method} {one.params}: {said}")
        found[method] = sorted(tried, key=lambda one: one.score)
        if math.isinf(found[method][0].score):
            notify(f"{method}: no form could be fitted; the suite's own stays")
    return found


def _try(
    one: Tried, trial: Trial, material: Material, held_out: Validation, seconds: float
) -> None:
    if one.failed:
        return
    budget: Budget = replace(trial.budget, seconds=seconds, until=None)
    generator = torch.Generator().manual_seed(stream_seed(FIT, trial.seed))
    try:
        method = registry.make(trial.method_name, **one.params)
        able, reason = method.supports(material)
        if not able:
            raise Unsupported(reason)
        method.bind(material)
        report = method.fit(material, budget, generator)
        kl = held_out.kl(method)
    except (InputError, Unsupported, BudgetExceeded, FloatingPointError) as error:
        one.failed = f"{trial.material}: {str(error).partition(chr(10))[0]}"
        return
    if not math.isfinite(kl):
        one.failed = f"{trial.material}: KL is {kl}"
        return
    one.kl[trial.material], one.steps[trial.material] = round(kl, 6), report.steps
