"""A layer over columns as loops around few instructions, for GPUs, which compile long code slowly.

Written out, a layer of 32 inputs and 32 outputs is a thousand loads and as many multiply-adds, and
a GPU's assembler takes minutes for a few such. As loops it is some dozens, of whatever size.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import torch

from harness.core.columns.bridge import Columns, Float, backend

TILE = 8
"""Outputs at a time; two loads of four weights for each input."""


class LoopedMatrix:
    """A matrix [out, in] and a bias [out] or None, float32, as arrays of one back end."""

    def __init__(self, array: type[Float], weight: np.ndarray, bias: np.ndarray | None):
        self.outputs, self.inputs = weight.shape
        self.tiles = -(-self.outputs // TILE)
        padded = np.zeros((self.tiles * TILE, self.inputs), np.float32)
        padded[: self.outputs] = weight
        tiles = padded.reshape(self.tiles, TILE, self.inputs).transpose(0, 2, 1)
        self.weights = array(np.ascontiguousarray(tiles).reshape(-1))
        start = np.zeros(self.tiles * TILE, np.float32)
        if bias is not None:
            start[: self.outputs] = bias
        self.biases = array(start)
        index = dr.uint32_array_t(array)
        # As data, or each size would be another kernel.
        self.counts = dr.opaque(index, self.inputs), dr.opaque(index, self.tiles)

    def __call__(self, x: Columns, biased: bool = True) -> Columns:
        """The product with ``x``, plus the bias unless it is not wanted."""
        array = type(self.weights)
        index, four = dr.uint32_array_t(array), _four(array)
        inputs, tiles = self.counts
        given = dr.alloc_local(array, self.inputs)
        for k, value in enumerate(x):
            given[k] = value
        found = dr.alloc_local(array, self.tiles * TILE)

        def one_tile(tile: Any, given: Any, found: Any) -> tuple:
            first = tile * (TILE // 4)
            start = [array(0)] * TILE
            if biased:
                start = [v for i in (0, 1) for v in dr.gather(four, self.biases, first + i)]

            def one_input(k: Any, given: Any, *sums: Float) -> tuple:
                place = (tile * inputs + k) * (TILE // 4)
                row = [v for i in (0, 1) for v in dr.gather(four, self.weights, place + i)]
                value = given[k]
                return k + 1, given, *(dr.fma(w, value, s) for w, s in zip(row, sums, strict=True))

            _, given, *sums = dr.while_loop(
                (index(0), given, *start), lambda k, *_: k < inputs, one_input,
                mode="symbolic", label="inputs",
            )  # fmt: skip
            for i, value in enumerate(sums):
                found[tile * TILE + i] = value
            return tile + 1, given, found

        _, _, found = dr.while_loop(
            (index(0), given, found), lambda tile, *_: tile < tiles, one_tile,
            mode="symbolic", label="outputs",
        )  # fmt: skip
        return [found[index(j)] for j in range(self.outputs)]


def _four(array: type[Float]) -> type:
    """``Array4f`` of the back end."""
    device = "cuda" if dr.backend_v(array) == dr.JitBackend.CUDA else "cpu"
    return backend(torch.device(device)).Array4f
