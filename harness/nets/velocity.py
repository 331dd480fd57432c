r"""The velocity field of a flow of the plane, u(x, t, condition), and its derivatives by x.

One perceptron of (x, t, encoded condition). The condition's share of the first layer is the same at
every x and t: it is computed once for all steps of a flow. Derivatives are taken forward: with the
activations of x go their derivatives along two directions, so that a step and its 2 x 2 Jacobian
are one pass of three vectors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import drjit.nn
import numpy as np
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.compiled.library import Library
from harness.core.protocol import counting
from harness.nets import activations
from harness.nets.compiled_flow import Numbers, PackedFlow
from harness.nets.encoding import Encoded
from harness.nets.forms import Forms
from harness.nets.looped import LoopedMatrix

REACH = 8.0


@dataclass(frozen=True)
class Shared:
    """What conditions are to a velocity: what they add to its first layer, when it is needed."""

    velocity: Velocity
    encoded: Encoded

    @cached_property
    def columns(self) -> Columns:
        """What is added to the first layer, a column a neuron."""
        return self.velocity.condition_columns(self.encoded.inputs)


class Velocity(nn.Module):
    r"""(x 2, t 1, encoded condition E) -> ``layers`` hidden layers of ``width`` -> u 2.

    x is seen as :math:`r \tanh(x / r)`, r = 8, which is x where samples are. So u is bounded, and
    every step :math:`x + h u` reaches the whole plane: a density asked for anywhere has a point
    that it comes from. ``bounded=False`` leaves x as it is. With ``waves`` the network sees the
    sines and cosines of x at 1, 2, 4, ... too. The last layer starts at zero, the flow as its base.

    Duals are tensors [3, B, D, 2] (or six columns): x, and its derivatives along two directions.
    """

    def __init__(
        self,
        encoded: int,
        width: int,
        layers: int,
        activation: str = "silu",
        bounded: bool = True,
        waves: int = 0,
    ):
        super().__init__()
        self.waves, self.own = waves, 3 + 4 * waves
        widths = [self.own + encoded, *[width] * layers, 2]
        self.layers = nn.ModuleList(
            nn.Linear(a, b) for a, b in zip(widths[:-1], widths[1:], strict=True)
        )
        nn.init.zeros_(self.layers[-1].weight)
        nn.init.zeros_(self.layers[-1].bias)
        with torch.no_grad():
            # x is two inputs of many, and the ones that the field bends along.
            self.layers[0].weight[:, :2] *= 3
        self.activation, self.bounded = activation, bounded
        self._forms = Forms()

    # --- torch -------------------------------------------------------------------------

    def shared(self, encoded: Tensor) -> Tensor:
        """What the condition adds to the first layer: [B, E] -> [B, 1, width]."""
        first = self.layers[0]
        return nn.functional.linear(encoded, first.weight[:, self.own :], first.bias)[:, None]

    def _seen(self, x: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """What the first layer sees of x, in parts [..., 2], and each part's slopes."""
        values, slopes = [x], [torch.ones_like(x)]
        if self.bounded:
            inner = torch.tanh(x / REACH)
            values, slopes = [REACH * inner], [1 - inner * inner]
        for k in range(self.waves):
            angle = 2**k * values[0]
            sin, cos = torch.sin(angle), torch.cos(angle)
            values += [sin, cos]
            slopes += [2**k * slopes[0] * cos, -(2**k) * slopes[0] * sin]
        return values, slopes

    def _place(self, parts: list[Tensor]) -> Tensor:
        """The first layer's matrix times those parts: [..., 2] each."""
        weight = self.layers[0].weight
        columns = torch.cat([weight[:, :2], weight[:, 3 : self.own]], 1)
        return torch.cat(parts, -1) @ columns.T

    def forward(self, x: Tensor, t: Tensor | float, shared: Tensor) -> Tensor:
        """u [B, D, 2] at x [B, D, 2], times ``t`` (a number, or [B, D, 1])."""
        counting.add("network", x[..., 0].numel())
        first, *rest = self.layers
        v = self._place(self._seen(x)[0]) + (shared + t * first.weight[:, 2])
        for layer in rest:
            v = layer(activations.value(self.activation, v))
        return v

    def push(self, dual: Tensor, t: float, shared: Tensor) -> Tensor:
        """u and its derivatives along the dual's two directions: [3, B, D, 2]."""
        counting.add("network", dual[0, ..., 0].numel())
        first, *rest = self.layers
        values, slopes = self._seen(dual[0])
        v = self._place(values) + (shared + t * first.weight[:, 2])
        tangents = self._place([slope * dual[1:] for slope in slopes])
        for layer in rest:
            value, tangents = activations.push(self.activation, v, tangents)
            v, tangents = layer(value), tangents @ layer.weight.T
        return torch.cat([v[None], tangents])

    # --- columns -----------------------------------------------------------------------

    def shared_columns(self, encoded: Encoded) -> Shared:
        """:meth:`shared` over columns."""
        return Shared(self, encoded)

    def condition_columns(self, encoded: Columns) -> Columns:
        """What the condition adds to the first layer."""
        return self._product("condition", encoded, type(encoded[-1]))

    def columns(self, x: Columns, t: Float, shared: Columns) -> Columns:
        """:meth:`forward` over columns."""
        array = type(shared[0])
        v = self._first(self._seen_columns(x)[0], t, shared)
        for i in range(1, len(self.layers)):
            v = self._product(i, activations.value_columns(self.activation, v), array)
        return v

    def push_columns(self, dual: Columns, t: Float, shared: Columns) -> Columns:
        """:meth:`push` over six columns: x, and the two derivatives."""
        array = type(shared[0])
        values, slopes = self._seen_columns(dual[:2])
        v = self._first(values, t, shared)
        zero, tangents = array(0), []
        for along in (dual[2:4], dual[4:6]):
            # Parts come in pairs, of x and of y.
            moved = [s * along[i % 2] for i, s in enumerate(slopes)]
            tangents.append(self._product("place", [*moved[:2], zero, *moved[2:]], array))
        for i in range(1, len(self.layers)):
            value, slope = activations.with_slope_columns(self.activation, v)
            v = self._product(i, value, array)
            tangents = [
                self._product(i, [s * d for s, d in zip(slope, along, strict=True)], array, False)
                for along in tangents
            ]
        return [*v, *tangents[0], *tangents[1]]

    def _seen_columns(self, x: Columns) -> tuple[Columns, Columns]:
        """:meth:`_seen` over columns: values and slopes, two a part."""
        array = type(x[0])
        values, slopes = list(x), [array(1), array(1)]
        if self.bounded:
            inner = [dr.tanh(v * (1 / REACH)) for v in x]
            values = [REACH * v for v in inner]
            slopes = [dr.fma(-v, v, 1) for v in inner]
        pairs = [dr.sincos(v) for v in values] if self.waves else []
        for k in range(self.waves):
            (sx, cx), (sy, cy) = pairs
            a, b = (2**k * s for s in slopes[:2])
            values += [sx, sy, cx, cy]
            slopes += [a * cx, b * cy, -a * sx, -b * sy]
            pairs = [(2 * s * c, dr.fma(-2 * s, s, 1)) for s, c in pairs]
        return values, slopes

    def _first(self, x: Columns, t: Float, shared: Columns) -> Columns:
        product = self._product("place", [*x[:2], t, *x[2:]], type(shared[0]))
        return [p + s for p, s in zip(product, shared, strict=True)]

    def _product(
        self, which: int | str, x: Columns, array: type[Float], biased: bool = True
    ) -> Columns:
        """A layer's matrix times ``x``; of the first, the part of the condition or of (x, t)."""
        if dr.backend_v(array) == dr.JitBackend.CUDA:
            return self._looped(array)[which](x, biased)
        weights, biases = self._pack(array)
        bias = biases.get(which) if biased else None
        vector = drjit.nn.CoopVec(*x)
        if bias is None:
            return list(drjit.nn.matvec(weights[which], vector))
        return list(drjit.nn.matvec(weights[which], vector, bias))

    def _looped(self, array: type[Float]) -> dict[int | str, LoopedMatrix]:
        """As loops: 32-bit cooperative vectors do not exist on CUDA."""

        def make() -> dict[int | str, LoopedMatrix]:
            made = {}
            for name in self._names:
                weight, bias = self._part(name)
                made[name] = LoopedMatrix(array, weight, bias)
            return made

        return self._kept("loops", make)

    @property
    def _names(self) -> list[int | str]:
        return ["condition", "place", *range(1, len(self.layers))]

    def _part(self, which: int | str) -> tuple[np.ndarray, np.ndarray | None]:
        """Matrix and bias of a layer, or of a part of the first."""
        layer = self.layers[which if isinstance(which, int) else 0]
        weight, bias = (v.detach().float().cpu().numpy() for v in (layer.weight, layer.bias))
        if which == "condition":
            return weight[:, self.own :], bias
        return (weight[:, : self.own], None) if which == "place" else (weight, bias)

    def _pack(self, array: type[Float]) -> tuple[dict, dict]:
        """Weights and biases as packed matrix views."""

        def make() -> tuple[dict, dict]:
            parts = [self._part(name) for name in self._names]
            tensor = dr.tensor_t(array)
            weights = [tensor(np.ascontiguousarray(w)) for w, _ in parts]
            biased = [
                name for name, (_, b) in zip(self._names, parts, strict=True) if b is not None
            ]
            biases = [array(b) for _, b in parts if b is not None]
            packed = drjit.nn.pack(*weights, *biases, layout="inference")
            n = len(parts)
            return (
                dict(zip(self._names, packed[:n], strict=True)),
                dict(zip(biased, packed[n:], strict=True)),
            )

        return self._kept("matrices", make)

    @property
    def compilable(self) -> bool:
        """Whether the compiled kernels know such a velocity: they have no waves."""
        return not self.waves

    def compiled(self, library: Library) -> PackedFlow:
        """The velocity as the compiled kernels run it."""

        def make() -> PackedFlow:
            rest = [self._part(i) for i in range(1, len(self.layers))]
            numbers = Numbers(self._part("condition"), self._part("place")[0], rest)
            slope = activations.SLOPES.get(self.activation, 0.0)
            return PackedFlow(library, numbers, self.activation, slope, self.bounded)

        return self._kept(f"compiled for {library.name}", make)

    def _kept(self, what: str, make: Callable[[], Any]) -> Any:
        return self._forms.of(self.parameters(), what, lambda _: make())
