"""The steps of a flow by the compiled kernels: all of them, and Newton's method, in one call."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from harness.core.columns.bridge import Columns
from harness.core.compiled.library import Library
from harness.nets.compiled_call import Call
from harness.nets.compiled_network import ACTIVATIONS, Layer, Network, encoding, pack
from harness.nets.encoding import Encoded

FORWARD, ENDPOINT, BACKWARD, INVERSE = range(4)
_OUTPUTS = {FORWARD: 7, ENDPOINT: 2, BACKWARD: 3, INVERSE: 4}
_NAMES = ("forward", "endpoint", "backward", "inverse")


class _Velocity(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int32) for name in ("width", "layers", "activation", "bounded")),
        ("slope", ctypes.c_float),
        *((name, ctypes.c_void_p) for name in ("place", "layer")),
    ]


class _Flow(ctypes.Structure):
    _fields_ = [("condition", ctypes.c_void_p), ("velocity", _Velocity), ("steps", ctypes.c_int32)]


@dataclass(frozen=True)
class Numbers:
    """Weights [out, in] and biases [out] of a velocity, float32.

    ``condition`` is the first layer's part for the encoded condition, with its bias; ``place``
    [W, 3] that for x, y and the time; ``rest`` the layers after it.
    """

    condition: tuple[np.ndarray, np.ndarray]
    place: np.ndarray
    rest: Sequence[tuple[np.ndarray, np.ndarray]]


class PackedFlow:
    """A velocity's weights in the order that the kernels read them."""

    def __init__(
        self, library: Library, numbers: Numbers, activation: str, slope: float, bounded: bool
    ):
        self.library = library
        self._kept: list[np.ndarray] = []
        self._condition = self._layers([numbers.condition], for_flow=False)
        self._rest = self._layers(numbers.rest, for_flow=True)
        place = np.ascontiguousarray(numbers.place.T, np.float32)
        self._kept.append(place)
        width = place.shape[1]
        self._velocity = _Velocity(
            width, len(numbers.rest), ACTIVATIONS[activation], bounded, slope,
            place.ctypes.data, ctypes.addressof(self._rest),
        )  # fmt: skip
        self.name = f"flow of {len(numbers.rest)} layers of {width}, {activation}"

    def _layers(self, pairs: Sequence[tuple[np.ndarray, np.ndarray]], for_flow: bool) -> Any:
        layers = (Layer * len(pairs))()
        for layer, (weight, bias) in zip(layers, pairs, strict=True):
            self._kept += pack(self.library, layer, weight, bias, for_flow)
        return layers

    def run(
        self, way: int, steps: int, encoded: Encoded, x: Columns, active: Any = None
    ) -> Columns:
        """Where Euler's steps lead from ``x``, in the rows that are ``active``.

        Computed when it returns: x and y; but for ENDPOINT the determinant of the map; for
        FORWARD the derivatives by x and by y, for INVERSE 1 where the start was found, else 0.
        """
        extra = list(x) if active is None else [*x, dr.select(active, type(x[0])(1), 0)]
        call = Call.of([*encoded.raw, *extra], _OUTPUTS[way])
        inputs = encoding(encoded)
        condition = Network(
            len(encoded.raw), encoded.width, 1, 0, 0.0, encoded.as_it_is,
            ctypes.addressof(inputs), ctypes.addressof(self._condition),
        )  # fmt: skip
        flow = _Flow(ctypes.addressof(condition), self._velocity, steps)

        def work(*pool: ctypes.c_void_p, kept: Any = (inputs, condition)) -> None:
            self.library.flow(
                ctypes.byref(flow),
                ctypes.c_uint32(call.rows),
                call.inputs,
                call.wide,
                ctypes.c_int32(active is not None),
                call.outputs,
                ctypes.c_int32(way),
                *pool,
            )

        return call.run(self.library, f"{self.name}, {steps} steps {_NAMES[way]}", work)
