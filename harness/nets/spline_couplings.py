"""Spline couplings in turn: NeuSample's map between directions and its base's points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.core.compiled.library import Library
from harness.core.protocol import counting
from harness.nets import spline
from harness.nets.compiled_couplings import Numbers, PackedCouplings
from harness.nets.compiled_network import usable
from harness.nets.coupling import CouplingNet
from harness.nets.encoding import Encoded
from harness.nets.forms import Forms


class SplineCouplings:
    """``couplings`` in turn over columns: i warps x given y where i is even, y given x where odd.

    With ``square``, x is over the chord of the disk at y, :func:`chord`. All couplings have one
    shape.
    """

    def __init__(self, couplings: Sequence[CouplingNet], bins: int, square: bool):
        self.couplings, self.bins, self.square = couplings, bins, square
        self._forms = Forms()

    def to_base_columns(self, wo: Columns, encoded: Encoded) -> tuple[Float, Float, Float]:
        """``(x, y, slope)``: the base's point of ``wo``, and the map's determinant there."""
        if library := self._usable(encoded, wo):
            self._count(encoded, wo, len(self.couplings))
            return tuple(self._compiled(library).to_base(encoded, wo))
        x, y = wo
        width = chord(y, self.square)
        warped = spline.warp_columns(self.couplings[0].columns(y, encoded), x / width)
        return self._onwards(y, width, encoded, warped)

    def draw_columns(
        self, at: Columns, encoded: Encoded, keep: Any, kept: Columns
    ) -> tuple[Columns, tuple[Float, Float, Float]]:
        """The direction of the base's point ``at``, or ``kept`` where ``keep``.

        Beside it what :meth:`to_base_columns` has at the direction as rounded, bit for bit.
        """
        if library := self._usable(encoded, [*at, *kept]):
            self._count(encoded, at, 2 * len(self.couplings) - 1)
            x, y, *back = self._compiled(library).draw(encoded, at, keep, kept)
            return [x, y], tuple(back)
        at = list(at)
        for i in range(len(self.couplings) - 1, 0, -1):
            own, other = i % 2, 1 - i % 2
            at[own], _ = spline.unwarp_columns(
                self.couplings[i].columns(at[other], encoded), at[own]
            )
        y = dr.select(keep, kept[1], at[1])
        width = chord(y, self.square)
        # The first spline, whose network sees y alone, goes there and back.
        numbers = self.couplings[0].columns(y, encoded)
        x = dr.select(keep, kept[0], spline.unwarp_columns(numbers, at[0])[0] * width)
        warped = spline.warp_columns(numbers, x / width)
        return [x, y], self._onwards(y, width, encoded, warped)

    def _onwards(
        self, y: Float, width: Float, encoded: Encoded, warped: Sequence[Float]
    ) -> tuple[Float, Float, Float]:
        """Through the couplings after the first, which gave ``warped``."""
        x, slope = warped
        at = [x, y]
        for i in range(1, len(self.couplings)):
            own, other = i % 2, 1 - i % 2
            numbers = self.couplings[i].columns(at[other], encoded)
            at[own], slope_own = spline.warp_columns(numbers, at[own])
            slope = slope * slope_own
        return *at, slope / width

    def _count(self, encoded: Encoded, at: Columns, networks: int) -> None:
        if counting.wanted():
            rows = max(dr.width(column) for column in (*encoded.raw, *at))
            counting.add("network", rows * networks)

    def _usable(self, encoded: Encoded, values: Columns) -> Library | None:
        return usable(encoded, *values, widths=self.couplings[0].mlp.widths, bins=self.bins)

    def _compiled(self, library: Library) -> PackedCouplings:
        """The couplings as the compiled kernels run them."""

        def make(numbers: list) -> PackedCouplings:
            each = len(numbers) // len(self.couplings)
            networks = [numbers[i : i + each] for i in range(0, len(numbers), each)]
            first = self.couplings[0]
            known = Numbers(
                networks, first.waves, first.frequencies, self.bins, self.square, first.mlp.slope
            )
            return PackedCouplings(library, known)

        parameters = chain.from_iterable(net.parameters() for net in self.couplings)
        return self._forms.of(parameters, f"compiled for {library.name}", make)


def chord(y: Float, square: bool) -> Float:
    """What x is over: half the disk's width at ``y`` (one off the disk), or one."""
    if not square:
        return type(y)(1)
    squared = (1 - y) * (1 + y)
    return dr.sqrt(dr.select(squared > 0, squared, 1))
