"""Materials, subjects and findings for tests of single properties."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from harness.checks.finding import Finding, verdict
from harness.checks.subject import Case, Subject, cases
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, Method
from tests import planted

LEVEL = 1e-5
SEEDS = range(4)
"""A correct adapter fails in one of these by chance with a probability below 1e-4 a property."""


def subject(method: Method, material: Material | None = None, seed: int = 0) -> Subject:
    """``method`` fitted to ``material``."""
    material = planted.Plaster() if material is None else material
    blank, generator = copy.deepcopy(method), torch.Generator().manual_seed(seed)
    budget = Budget(steps=20, conditions=32, directions=16, resolution=16, pool=64)
    method.fit(material, budget, generator)
    return Subject(method, blank, material, "cpu", generator, seed)


def case(checked: Subject, name: str = "oblique") -> Case:
    """An ordinary condition."""
    return next(c for c in cases(checked.material, checked.generator, "cpu") if c.name == name)


def found(check: Callable[..., Any], *arguments: Any) -> list[Finding]:
    """What a check says, as a list."""
    result = check(*arguments)
    return [result] if isinstance(result, Finding) else list(result)


def worst(check: Callable[..., Any], *arguments: Any) -> str:
    """The verdict of a check; a failure has to show its worst input or say what is wrong."""
    finding = verdict(found(check, *arguments))
    assert finding.verdict != "fail" or finding.worst or finding.text
    return finding.verdict


class Even(planted.Correct):
    """The uniform disk."""

    weights = (1.0, 0.0, 0.0)

    def draw(self, condition: Tensor, u: Tensor, *share: Any) -> Tensor:
        return square_to_disk(u[:, 1:])


# --- gradients ---------------------------------------------------------------------------------


class Bump(nn.Module):
    """One number, and how its logarithm is taken."""

    def __init__(self) -> None:
        super().__init__()
        self.raw = nn.Parameter(torch.zeros(2))
