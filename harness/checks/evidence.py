"""What one case's statistical tests look at: samples, and the density integrated over cells.

Drawn and integrated once, when first asked for, and shared by the properties of the case. Their
tests are then not independent of each other; the Šidák level, which all but equals
Bonferroni's at such rates, covers that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.checks.quadrature import Hints, Masses, hemisphere_to_square, integrate, per_square
from harness.checks.subject import Case, Subject
from harness.core.protocol.method import DiskSample
from harness.stats.cells import Cells

PILOT = 1 << 15
SAMPLES = 1 << 17


@dataclass
class Evidence:
    """Of ``subject`` in ``case``. Points are those of the unit square of ``quadrature``."""

    subject: Subject
    case: Case

    @cached_property
    def condition(self) -> Tensor:
        """The case's row for each sample, [SAMPLES, C]."""
        return self.case.rows(SAMPLES)

    @cached_property
    def u(self) -> Tensor:
        """Uniforms of the samples, [SAMPLES, 3]."""
        return self._uniforms(SAMPLES, "samples")

    @cached_property
    def pilot(self) -> DiskSample:
        """``PILOT`` samples, independent of the others: what shapes a test must not be tested."""
        return self.subject.sample(self.case.rows(PILOT), self._uniforms(PILOT, "pilot"))

    @cached_property
    def drawn(self) -> DiskSample:
        """``SAMPLES`` samples."""
        # Copies: a method that writes to its inputs is found out by a property of its own.
        return self.subject.sample(self.condition.clone(), self.u.clone())

    @cached_property
    def asked(self) -> Tensor:
        """``pdf`` of the samples, [SAMPLES]."""
        return self.subject.pdf(self.condition.clone(), self.drawn.wo)

    @cached_property
    def places(self) -> tuple[NDArray, NDArray]:
        """Points [n, 2] of the valid samples, and which are valid, bool [SAMPLES]."""
        return hemisphere_to_square(self.drawn.wo)

    @cached_property
    def coarse(self) -> Cells:
        """Cells that hold enough of the samples for a chi-square test, by the pilot."""
        points, _ = hemisphere_to_square(self.pilot.wo)
        return Cells.uniform(4).refined(points, PILOT // 256)

    @cached_property
    def masses(self) -> Masses:
        """The density's mass in cells that refine :attr:`coarse`."""
        points, valid = self.places
        density = per_square(self.asked, self.drawn.wo)[valid]
        # A density that is no number hints at nothing; the integral will not be finite either.
        known = np.isfinite(density)
        hints = Hints(points[known], density[known])
        random = self.subject.stream(self.case.name, "quadrature")
        return integrate(
            lambda wo: self.subject.pdf(self.case.rows(len(wo)), wo.to(self.subject.device)),
            hints,
            np.random.default_rng(int(torch.randint(1 << 62, (), generator=random))),
            self.coarse.refined(points, SAMPLES // 2048),
        )

    def _uniforms(self, n: int, what: str) -> Tensor:
        generator = self.subject.stream(self.case.name, what)
        return torch.rand(n, 3, generator=generator).to(self.subject.device)


def evidence(subject: Subject, case: Case) -> Evidence:
    """That of ``case``, kept until another case is asked for."""
    kept = subject.kept.get("evidence")
    if kept is None or kept.case is not case or kept.subject.method is not subject.method:
        kept = Evidence(subject, case)
        subject.kept["evidence"] = kept
    return kept
