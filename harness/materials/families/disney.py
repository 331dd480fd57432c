"""Disney's principled BSDF (Burley 2012), Mitsuba's ``principled``, over two parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from harness.core.columns.bridge import Columns, Float
from harness.materials.families.base import Family
from harness.materials.families.parameters import DISNEY, Parameter
from harness.materials.mitsuba_bsdf import MitsubaMaterial, mitsuba
from harness.mitsuba_runtime.bitmaps import with_bitmaps

BASE_COLOR = (0.72, 0.45, 0.2)
_TEXELS = 4096
"""Of a tile: the fall from its end to the next one's start is as wide as one."""


class Disney(Family):
    """Mitsuba's ``principled``, its parameters per row; all others at Mitsuba's defaults.

    Metallic and roughness vary as in Bai et al. (2023), section 6.3; the base colour is
    ``BASE_COLOR``. Roughness r stands for GGX of alpha = r^2, so that uniform r is uniform in
    the square root of alpha.

    Each free parameter is a texture that rises linearly over the unit square of (u, v), the
    first along u, the second along v. A row is evaluated at the (u, v) that has its
    parameters; and a surface with texture coordinates shows the whole family, on every tile. So
    ``bsdf`` is one ordinary Mitsuba BSDF, with its own sampler, and renders natively.
    """

    family = "disney"
    model = DISNEY

    def __init__(self, name: str, fix: Mapping[str, float], identity: dict[str, Any]):
        super().__init__(name, fix, identity)
        # On rows the edges count, 0 and 1 alike; on surfaces coordinates go on beyond them.
        self._nested = MitsubaMaterial(name, self._principled(_ramp), identity)
        mi = mitsuba()
        self.bsdf = mi.load_dict(with_bitmaps(mi, self._principled(_sawtooth)))

    def _principled(self, texture: Callable[[Parameter, int], dict[str, Any]]) -> dict[str, Any]:
        bsdf: dict[str, Any] = {
            "type": "principled",
            "base_color": {"type": "rgb", "value": list(BASE_COLOR)},
            **self.fixed,
        }
        return bsdf | {p.name: texture(p, axis) for axis, p in enumerate(self.parameters)}

    def mitsuba_bsdf(self) -> Any:
        """See :meth:`Material.mitsuba_bsdf`."""
        return self.bsdf

    def eval_columns(self, c: Columns, wo: Columns, seed: int = 0) -> Any:
        """See :meth:`Family.eval_columns`; a Mitsuba colour, in closed form."""
        return self._nested.eval_columns(self._placed(c), wo)

    def native_sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`MitsubaMaterial.native_sample_columns`."""
        return self._nested.native_sample_columns(self._placed(c), u)

    def native_pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`MitsubaMaterial.native_pdf_columns`."""
        return self._nested.native_pdf_columns(self._placed(c), wo)

    def _placed(self, c: Columns) -> Columns:
        """``[u, v, wi.x, wi.y]`` for the parameters of ``c``, ``[wi.x, wi.y]`` if all are fixed."""
        if not self.parameters:
            return c
        uv = [
            (column - p.low) / (p.high - p.low)
            for column, p in zip(c, self.parameters, strict=False)
        ]
        return [*uv, *([uv[0] * 0] * (2 - len(uv))), *c[-2:]]


def _ramp(parameter: Parameter, axis: int) -> dict[str, Any]:
    """A texture of ``parameter.low`` at 0 and ``high`` at 1 along u (axis 0) or v (1).

    Two texels with bilinear interpolation, the unit square scaled to lie between their
    centres; beyond it the value stays what it is at the edge.
    """
    inner = mitsuba().ScalarTransform3f().translate([0.25, 0.25]).scale([0.5, 0.5])
    ends = np.array([parameter.low, parameter.high], dtype=np.float32)
    return _bitmap(ends, axis, "clamp") | {"to_uv": inner}  # (u, v) -> 1/4 + (u, v) / 2


def _sawtooth(parameter: Parameter, axis: int) -> dict[str, Any]:
    """As :func:`_ramp` within the unit square, and the same on every other one.

    Exact but for the last and first half texel, where it falls back.
    """
    rise = (np.arange(_TEXELS, dtype=np.float32) + 0.5) / _TEXELS
    return _bitmap(parameter.low + (parameter.high - parameter.low) * rise, axis, "repeat")


def _bitmap(values: np.ndarray, axis: int, wrap_mode: str) -> dict[str, Any]:
    """A texture of ``values`` along u (axis 0) or v (1), interpolated between texels' centres."""
    return {
        "type": "bitmap",
        "array": values.reshape((-1, 1, 1) if axis else (1, -1, 1)),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": wrap_mode,
        "accel": False,  # a GPU's texture unit interpolates in steps of 1/256
    }
