"""States of an invertible map that single precision cannot follow: measured, and refused."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor

from harness.core.protocol.errors import StateRefused
from harness.fitting.module_method import ModuleMethod

UNIT = 2.0**-24
"""By how much single precision rounds a coordinate near one."""
STEADY = 1 / 64
"""Standard deviations of the base by which that rounding may move a base point.

Fits of the paper's size and budget stay three hundred times below."""
ROWS = 4096
"""Samples looked at, each in a condition of its own. Not one may be moved by more: a thousandth
of one condition's samples in the wrong place is what a test of the tail finds."""


class SteadyMethod(ModuleMethod):
    """A method whose density is that of its samples as long as rounding leaves them their origin.

    A subclass measures it (:meth:`unsteady`); :meth:`load_state_dict` refuses what moves, and so
    has a subclass's ``fit`` to, by :meth:`refuse_unsteady`.
    """

    origin: ClassVar[str]
    """What a direction comes from, in a sentence: ``its base point``."""

    @abstractmethod
    def unsteady(self) -> float:
        """Share of ``ROWS`` samples, always the same ones, that are moved when wo is rounded."""

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """See :meth:`Method.load_state_dict`; ``bind`` first.

        Raises:
            StateRefused: single precision cannot follow this state (:meth:`unsteady`).
        """
        super().load_state_dict(state)
        self.refuse_unsteady()

    def refuse_unsteady(self) -> None:
        """:class:`StateRefused` if any sample is moved."""
        share = self.unsteady()
        if share:
            raise self.moved_by_rounding(share)

    def moved_by_rounding(self, share: float) -> StateRefused:
        """What is said of a state in which that share of the samples is moved."""
        return StateRefused(
            f"{self.name}: state refused: in {share:.2%} of the samples the rounding of the"
            f" direction moves {self.origin} by more than {STEADY:.1g} deviations, so that the"
            " density would not be that of what is drawn; expected none",
            share,
        )


def moved(origin: Callable[[Tensor], Tensor], wo: Tensor, deviation: float) -> Tensor:
    """Whether rounding one coordinate of ``wo`` [N, 2] moves its origin [N, K]: bool [N].

    In double precision, so that nothing but the map itself moves it; by more than ``STEADY``
    times the ``deviation`` of an origin.
    """
    at = origin(wo)
    steps = UNIT * torch.eye(2, dtype=wo.dtype, device=wo.device)
    far = [(origin(wo + step) - at).abs().amax(1) for step in steps]
    return torch.stack(far).amax(0) > STEADY * deviation
