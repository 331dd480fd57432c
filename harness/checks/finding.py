"""What a check says about one property in one case."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor

Verdict = Literal["pass", "degraded", "fail", "skip"]
WORST_FIRST: tuple[Verdict, ...] = ("fail", "degraded", "pass", "skip")


@dataclass(frozen=True)
class Finding:
    """One property, one case.

    ``verdict`` is "pass", "degraded" (right, yet by construction unable to do the case
    well), "fail" (wrong), or "skip" (does not apply here). ``text`` says what was found on one
    line; ``worst`` the worst input with the number it gave and the one it should have given,
    by name. ``number`` is what the property measures (a lost share, an efficiency), in ``unit``.
    """

    property: str
    case: str
    verdict: Verdict
    text: str
    worst: dict[str, Any] = field(default_factory=dict)
    number: float | None = None
    unit: str = ""

    def __post_init__(self) -> None:
        if self.verdict not in WORST_FIRST:
            raise ValueError(f"verdict {self.verdict!r}: expected one of {WORST_FIRST}")

    @property
    def ok(self) -> bool:
        """Whether the adapter may pass: everything but "fail"."""
        return self.verdict != "fail"

    def line(self) -> str:
        """The finding on one line."""
        word = self.verdict.upper() if self.verdict == "fail" else self.verdict
        return f"{word:<8}  {self.property:<16} {self.case:<16} {self.text}"

    def worst_line(self) -> str:
        """The worst input on one line; empty where there is none."""
        return ", ".join(f"{name} {value}" for name, value in self.worst.items())


def held(ok: bool) -> Verdict:
    """The verdict of a property that holds or does not."""
    return "pass" if ok else "fail"


def verdict(findings: Iterable[Finding]) -> Finding:
    """The first of the worst: fail before degraded before pass before skip.

    Raises:
        ValueError: there are none.
    """
    return min(findings, key=lambda finding: WORST_FIRST.index(finding.verdict))


def rounded(value: Tensor | float) -> Any:
    """A tensor or number as short plain data for ``worst``."""
    if isinstance(value, Tensor):
        value = value.detach().to("cpu", torch.float64)
        if value.ndim:
            return "(" + ", ".join(f"{v:.7g}" for v in value.ravel().tolist()) + ")"
        value = value.item()
    return f"{value:.7g}"
