"""What is checked: a fitted method, its material, and where randomness comes from."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Method

COSINES = {"normal": 1.0, "oblique": 0.7, "steep": 0.3, "grazing": 0.05}
RANDOM_CASES = 2


@dataclass(frozen=True)
class Case:
    """A named condition, one row [C]."""

    name: str
    row: Tensor

    def rows(self, n: int) -> Tensor:
        """The condition ``n`` times, [n, C], in memory of its own."""
        return self.row.expand(n, -1).clone()


@dataclass
class Subject:
    """``blank`` is the method as constructed, before fitting, for loading state into.

    ``generator`` is what the property at hand draws from; ``kept`` what its case has drawn and
    integrated already (see :mod:`harness.checks.evidence`).
    """

    method: Method
    blank: Method
    material: Material
    device: str
    generator: torch.Generator
    seed: int = 0
    kept: dict[str, Any] = field(default_factory=dict, repr=False)

    def stream(self, *words: str) -> torch.Generator:
        """A generator of its own for what ``words`` name.

        Each property of each case has one, so that it draws the same numbers whether it
        runs alone or among all others.
        """
        return stream(self.seed, self.material.name, *words)

    def uniforms(self, n: int) -> Tensor:
        """Uniforms [n, 3] in [0, 1)."""
        return torch.rand(n, 3, generator=self.generator).to(self.device)

    def conditions(self, n: int) -> Tensor:
        """Random conditions [n, C]."""
        return self.material.conditions(n, self.generator, self.device)

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """:meth:`Method.sample`, refusing wrong shapes and types."""
        drawn = self.method.sample(condition, u)
        if not (isinstance(drawn, tuple) and len(drawn) == 2):
            raise WrongOutput(f"sample returned {type(drawn).__name__}, expected DiskSample")
        wo, pdf = drawn
        _expect(wo, (len(condition), 2), "sample's wo")
        _expect(pdf, (len(condition),), "sample's pdf")
        return DiskSample(wo, pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """:meth:`Method.pdf`, refusing wrong shapes and types."""
        pdf = self.method.pdf(condition, wo)
        _expect(pdf, (len(condition),), "pdf")
        return pdf


class WrongOutput(Exception):
    """An adapter returned something of the wrong type or shape."""


def stream(seed: int, *words: str) -> torch.Generator:
    """A generator whose seed is a digest of ``seed`` and ``words``: other words, other numbers."""
    digest = hashlib.sha256("/".join([str(seed), *words]).encode()).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest[:8], "big") >> 1)


def cases(material: Material, generator: torch.Generator, device: str) -> list[Case]:
    """The conditions of the statistical tests: fixed inclinations at random places, and random."""
    rows = material.conditions(len(COSINES) + RANDOM_CASES, generator, device).clone()
    azimuth = 2 * math.pi * torch.rand(len(COSINES), generator=generator).to(device)
    cosine = torch.tensor(list(COSINES.values()), device=device)
    sine = (1 - cosine.square()).sqrt()
    rows[: len(COSINES), -2] = sine * azimuth.cos()
    rows[: len(COSINES), -1] = sine * azimuth.sin()
    names = [*COSINES, *(f"random-{i + 1}" for i in range(RANDOM_CASES))]
    return [Case(name, row) for name, row in zip(names, rows, strict=True)]


def _expect(value: object, shape: tuple[int, ...], what: str) -> None:
    if not isinstance(value, Tensor):
        raise WrongOutput(f"{what} is a {type(value).__name__}, expected a tensor")
    if tuple(value.shape) != shape:
        raise WrongOutput(f"{what} has shape {tuple(value.shape)}, expected {shape}")
    if not value.is_floating_point():
        raise WrongOutput(f"{what} has type {value.dtype}, expected floating point")
