"""Spline couplings by the compiled kernels: networks, splines and chords of all in one call."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import numpy as np

from harness.core.columns.bridge import Columns
from harness.core.compiled.library import Library
from harness.nets.compiled_call import Call
from harness.nets.compiled_network import Layer, Network, encoding, pack
from harness.nets.encoding import Encoded

_TO_BASE, _DRAW = range(2)
_RESULTS = {_TO_BASE: 3, _DRAW: 5}
_NAMES = ("to the base", "draw")


class _Couplings(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("condition", "waves", "layer")),
        *((name, ctypes.c_int32) for name in ("count", "width", "rest", "bins", "square")),
        ("slope", ctypes.c_float),
    ]


@dataclass(frozen=True)
class Numbers:
    """Weights [out, in] and biases [out] of every coupling's layers in turn, float32.

    Of a first layer's inputs the first ``waves`` are the other coordinate at ``frequencies``
    octaves, the rest the encoded condition. ``slope`` is of the activation for negative numbers.
    """

    networks: Sequence[Sequence[np.ndarray]]
    waves: int
    frequencies: int
    bins: int
    square: bool
    slope: float


class PackedCouplings:
    """The couplings' weights in the order that the kernels read them."""

    def __init__(self, library: Library, numbers: Numbers):
        self.library, self.numbers = library, numbers
        self._kept: list[np.ndarray] = []
        pairs = [pair for network in numbers.networks for pair in self._layers(network)]
        self._layer = (Layer * len(pairs))()
        for layer, (weight, bias) in zip(self._layer, pairs, strict=True):
            self._kept += pack(library, layer, weight, bias)
        self._width = pairs[0][0].shape[0]
        self._rest = len(pairs) // len(numbers.networks) - 2
        # The kernels encode a column of their own.
        self._coordinate = encoding(Encoded.waves([None], numbers.frequencies))
        self.name = f"{len(numbers.networks)} spline couplings of {numbers.bins} bins"

    def _layers(self, network: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weight and bias of each layer, the first in two parts: condition, then coordinate."""
        (weight, bias), *rest = zip(network[0::2], network[1::2], strict=True)
        waves = self.numbers.waves
        return [(weight[:, waves:], bias), (weight[:, :waves], np.zeros_like(bias)), *rest]

    def to_base(self, encoded: Encoded, wo: Columns) -> Columns:
        """See :meth:`SplineCouplings.to_base_columns`; computed when it returns."""
        return self._run(encoded, _TO_BASE, list(wo))

    def draw(self, encoded: Encoded, at: Columns, keep: Any, kept: Columns) -> Columns:
        """See :meth:`SplineCouplings.draw_columns`: the direction, then its base's point, slope."""
        return self._run(encoded, _DRAW, [*at, dr.select(keep, type(at[0])(1), 0), *kept])

    def _run(self, encoded: Encoded, direction: int, extra: Columns) -> Columns:
        call = Call.of([*encoded.raw, *extra], _RESULTS[direction])
        inputs = encoding(encoded)
        condition = Network(
            len(encoded.raw), encoded.width, 0, 0, 0.0, encoded.as_it_is,
            ctypes.addressof(inputs), None,
        )  # fmt: skip
        waves = Network(
            1, self.numbers.waves, 0, 0, 0.0, 0, ctypes.addressof(self._coordinate), None
        )
        couplings = _Couplings(
            ctypes.addressof(condition), ctypes.addressof(waves), ctypes.addressof(self._layer),
            len(self.numbers.networks), self._width, self._rest, self.numbers.bins,
            self.numbers.square, self.numbers.slope,
        )  # fmt: skip

        def work(
            *pool: ctypes.c_void_p, splines: bool = True, kept: Any = (inputs, condition, waves)
        ) -> None:
            self.library.couplings(
                ctypes.byref(couplings),
                ctypes.c_uint32(call.rows),
                call.inputs,
                call.wide,
                call.outputs,
                ctypes.c_int32(direction),
                ctypes.c_int32(splines),
                *pool,
            )

        what = f"{self.name}, {_NAMES[direction]}"
        return call.run(self.library, what, work, partial(work, splines=False))
