"""A network over columns by the compiled kernels: weights packed once, columns by address."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from harness.core.columns.bridge import Columns, Float
from harness.core.compiled.library import Library, found
from harness.nets.compiled_call import Call
from harness.nets.encoding import Encoded

MOST, MOST_BINS = 4096, 512
"""Columns, and neurons of a layer, that the kernel has room for; bins of a spline."""
MOST_ROWS = 1 << 23
"""More, as a fine grid of directions has them, stay in Dr.Jit's kernel: here every input and output
is an array, gigabytes of them."""
ACTIVATIONS = {"relu": 0, "leaky_relu": 0, "silu": 1}


class _Input(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int32) for name in ("encoding", "place", "step", "frequencies")),
        *((name, ctypes.c_float) for name in ("mean", "scale")),
    ]


class Layer(ctypes.Structure):
    """Of the kernels' source; see :func:`pack`."""

    _fields_ = [
        *((name, ctypes.c_int32) for name in ("inputs", "outputs")),
        *((name, ctypes.c_void_p) for name in ("weights", "biases")),
    ]


class Network(ctypes.Structure):
    """Of the kernels' source."""

    _fields_ = [
        *((name, ctypes.c_int32) for name in ("columns", "encoded", "layers", "activation")),
        ("slope", ctypes.c_float),
        ("plain", ctypes.c_int32),
        *((name, ctypes.c_void_p) for name in ("inputs", "layer")),
    ]


def usable(x: Encoded, *others: Float, widths: Sequence[int] = (), bins: int = 0) -> Library | None:
    """The kernels, if they can run a network of these ``widths`` on these columns now.

    Not inside of what Dr.Jit records to run later, where columns have no values yet; not for
    derivatives by the columns, which only Dr.Jit has; not on a GPU.
    """
    raw = [*x.raw, *others]
    if max((len(raw), *widths)) > MOST or bins > MOST_BINS:
        return None
    if max(dr.width(column) for column in raw) > MOST_ROWS:
        return None
    if dr.backend_v(raw[-1]) != dr.JitBackend.LLVM or dr.flag(dr.JitFlag.SymbolicScope):
        return None
    if any(dr.grad_enabled(column) for column in raw):
        return None
    library = found()
    return None if isinstance(library, str) else library


class Packed:
    """Weights and biases of a network in the order that the kernels read them.

    ``numbers`` are a weight [out, in] and a bias [out] for each layer, float32.
    """

    def __init__(
        self, library: Library, numbers: Sequence[np.ndarray], activation: str, slope: float | None
    ):
        self.library = library
        self.activation, self.slope = ACTIVATIONS[activation], slope or 0.0
        pairs = list(zip(numbers[0::2], numbers[1::2], strict=True))
        self.layers = (Layer * len(pairs))()
        self._kept: list[np.ndarray] = []
        for layer, (weight, bias) in zip(self.layers, pairs, strict=True):
            self._kept += pack(library, layer, weight, bias)
        self.outputs = pairs[-1][0].shape[0]
        sizes = [pairs[0][0].shape[1], *(weight.shape[0] for weight, _ in pairs)]
        self.name = f"network {'-'.join(map(str, sizes))} {activation}"
        self._encoding: tuple[tuple, Any] = (), None

    def __call__(self, x: Encoded) -> Columns:
        """The network's outputs; computed when it returns."""
        call = Call.of(x.raw, self.outputs)
        inputs = self._inputs(x)
        network = Network(
            len(x.raw), x.width, len(self.layers), self.activation, self.slope, x.as_it_is,
            ctypes.addressof(inputs), ctypes.addressof(self.layers),
        )  # fmt: skip

        def work(*pool: ctypes.c_void_p) -> None:
            self.library.network(
                ctypes.byref(network),
                ctypes.c_uint32(call.rows),
                call.inputs,
                call.wide,
                call.outputs,
                *pool,
            )

        return call.run(self.library, self.name, work)

    def _inputs(self, x: Encoded) -> ctypes.Array:
        """How each raw column is encoded; made again where that changes."""
        shape = tuple(
            (len(g.columns), g.frequencies, tuple(g.mean), tuple(g.scale)) for g in x.groups
        )
        if self._encoding[0] != shape:
            self._encoding = shape, encoding(x)
        return self._encoding[1]


def pack(
    library: Library, layer: Layer, weight: np.ndarray, bias: np.ndarray, for_flow: bool = False
) -> list[np.ndarray]:
    """Fills in ``layer`` with weights in the order that the kernels read them.

    Returns what it points to, to be kept.
    """
    outputs, inputs = weight.shape
    packed = np.empty(weight.size, np.float32)
    weight = np.ascontiguousarray(weight, np.float32)
    bias = np.array(bias, np.float32)
    sizes = (ctypes.c_int32(number) for number in (inputs, outputs, for_flow))
    library.pack(_at(weight), *sizes, _at(packed))
    layer.inputs, layer.outputs = inputs, outputs
    layer.weights, layer.biases = packed.ctypes.data, bias.ctypes.data
    return [packed, bias]


def encoding(x: Encoded) -> ctypes.Array:
    """How each raw column is encoded."""
    made, place = [], 0
    for group in x.groups:
        n = len(group.columns)
        for i in range(n):
            if group.frequencies is None:
                mean, scale = (group.mean[i], group.scale[i]) if group.mean else (0.0, 1.0)
                made.append(_Input(0, place + i, 0, 0, mean, scale))
            else:
                made.append(_Input(1, place + i, n, group.frequencies, 0.0, 1.0))
        place += group.width
    return (_Input * len(made))(*made)


def _at(numbers: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(numbers.ctypes.data)
