"""Any Mitsuba BSDF as a material."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.columns.material import ColumnMaterial
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.mitsuba_runtime.bitmaps import with_bitmaps


def _mi() -> Any:
    import mitsuba

    if mitsuba.variant() is None:
        from harness.mitsuba_runtime.variant import use

        use("cpu")
    return mitsuba


class MitsubaMaterial(ColumnMaterial):
    """A reflective Mitsuba BSDF.

    ``bsdf`` is a Mitsuba dictionary, in which ``{"type": "bitmap", "array": ndarray}`` stands
    for a bitmap of those texels, or a BSDF that is loaded already. Every spatially varying
    texture below it becomes features: its value at (u, v), one column per channel that
    varies. The condition is ``[u, v, features, wi.xy]`` with textures, ``[wi.xy]`` without.

    It gives the effect ``texture`` where all its textures are bitmaps: without it each is the
    mean of its texels. For that a second BSDF is made, from the dictionary or by ``again()``.

    Raises:
        InputError: the BSDF cannot be loaded, transmits, or has a delta lobe (which no
            density on the disk represents).
    """

    def __init__(
        self,
        name: str,
        bsdf: Any,
        identity: dict[str, Any],
        again: Callable[[], Any] | None = None,
    ):
        self.name = name
        self._identity = identity
        mi = _mi()
        if isinstance(bsdf, dict):
            again = lambda: mi.load_dict(with_bitmaps(mi, bsdf))  # noqa: E731
        try:
            self.bsdf = again() if isinstance(bsdf, dict) else bsdf
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise InputError(f"material '{name}': Mitsuba cannot load it: {reason}") from None
        self._again, self._plain = again, None
        self._refuse_what_a_disk_cannot_hold(mi)
        self._textures = _varying_textures(mi, self.bsdf)
        self.n_address = 2 if self._textures or self._varies_unseen(mi) else 0
        self._channels = self._find_channels(mi)
        self.n_features = len(self._channels)
        bitmaps = all("data" in mi.traverse(texture) for _, texture in self._textures)
        self.effects = frozenset({"texture"} if self._textures and bitmaps and again else ())

    def with_effects(self, effects: frozenset[str]) -> Material:
        """See :meth:`Material.with_effects`; without ``texture``, every texture is its mean.

        Features are then the same everywhere, and the place on the material is of no account.
        """
        if "texture" in effects or not self.effects:
            return self
        if self._plain is None:
            mi = _mi()
            plain = copy.copy(self)
            plain.bsdf, plain.effects = self._again(), frozenset()
            plain._textures = _varying_textures(mi, plain.bsdf)
            for _, texture in plain._textures:
                texels = mi.traverse(texture)
                mean = np.array(texels["data"]).mean((0, 1), keepdims=True, dtype=np.float64)
                texels["data"] = mi.TensorXf(mean.astype(np.float32))
                texels.update()
            plain._identity = {**self._identity, "effects": []}
            self._plain = plain
        return self._plain

    def mitsuba_bsdf(self) -> Any:
        """See :meth:`Material.mitsuba_bsdf`."""
        return self.bsdf

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return self._identity

    def places(self, uv: Tensor) -> Tensor:
        """See :meth:`Material.places`."""
        if not self.n_address or len(uv) == 0:
            return uv.new_empty(len(uv), self.n_address + self.n_features)
        mi = _mi()
        si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
        si.uv = mi.Point2f(*columns_of(uv))
        return tensor_of(*self._place(si), rows=len(uv))

    def eval_columns(self, c: Columns, wo: Columns) -> Any:
        """BSDF without cosine over columns: a Mitsuba colour."""
        mi = _mi()
        si = self.interaction(c)
        x, y = wo
        cos_squared = 1 - x * x - y * y
        inside = cos_squared > 0
        cos = dr.sqrt(dr.select(inside, cos_squared, 1))
        value = self.bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(x, y, cos), inside)
        # Mitsuba includes the cosine; off the hemisphere there is nothing to divide.
        return dr.select(inside, value / cos, 0)

    def condition_columns(self, si: Any) -> Columns:
        """The condition at surface interactions, as a renderer meets it."""
        return [*self._place(si), si.wi.x, si.wi.y]

    def interaction(self, c: Columns) -> Any:
        """Surface interactions that have the given conditions."""
        mi = _mi()
        x, y = c[-2:]
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(x))
        # wi lies on the disk; rounding may push the rim out by one ulp, not a direction away.
        si.wi = mi.Vector3f(x, y, dr.sqrt(dr.maximum(1 - x * x - y * y, 0)))
        if self.n_address:
            si.uv = mi.Point2f(c[0], c[1])
        frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
        si.sh_frame = frame
        si.n = mi.Normal3f(0, 0, 1)
        # Normal and bump maps build their frame from these.
        si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        return si

    def native_sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """The BSDF's own sampler: ``(x, y, pdf per disk area)``; invalid samples off the disk."""
        mi = _mi()
        sample, _ = self.bsdf.sample(
            mi.BSDFContext(), self.interaction(c), u[0], mi.Point2f(u[1], u[2]), True
        )
        valid = (sample.pdf > 0) & (sample.wo.z > 0)
        # An invalid sample has no direction. (2, 0) is off the disk, where pdf must be 0.
        x = dr.select(valid, sample.wo.x, 2)
        y = dr.select(valid, sample.wo.y, 0)
        return x, y, dr.select(valid, sample.pdf / sample.wo.z, 0)

    def native_pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """Density per disk area of :meth:`native_sample_columns`."""
        mi = _mi()
        x, y = wo
        cos_squared = 1 - x * x - y * y
        inside = cos_squared > 0
        cos = dr.sqrt(dr.select(inside, cos_squared, 1))
        direction = mi.Vector3f(x, y, cos)
        pdf = self.bsdf.pdf(mi.BSDFContext(), self.interaction(c), direction, inside)
        return dr.select(inside, pdf / cos, 0)

    def _place(self, si: Any) -> Columns:
        if not self.n_address:
            return []
        values = [texture.eval(si) for _, texture in self._textures]
        return [si.uv.x, si.uv.y] + [values[t][channel] for t, channel in self._channels]

    def _find_channels(self, mi: Any) -> list[tuple[int, int]]:
        """Texture channels that vary over uv and repeat no earlier one of their texture."""
        grid = dr.linspace(mi.Float, 0.5 / 64, 1 - 0.5 / 64, 64)
        u, v = dr.meshgrid(grid, grid)
        si = dr.zeros(mi.SurfaceInteraction3f, 64 * 64)
        si.uv = mi.Point2f(u, v)
        found = []
        for t, (_, texture) in enumerate(self._textures):
            seen: list[Any] = []
            for channel, value in enumerate(texture.eval(si)):
                column = value.numpy()
                if column.max() > column.min() and not any((column == s).all() for s in seen):
                    seen.append(column)
                    found.append((t, channel))
        return found

    def _varies_unseen(self, mi: Any) -> bool:
        """Whether the BSDF needs uv for something that is no texture of its own (mesh data)."""
        return bool(self.bsdf.needs_differentials())

    def _refuse_what_a_disk_cannot_hold(self, mi: Any) -> None:
        flags = self.bsdf.flags()
        if mi.has_flag(flags, mi.BSDFFlags.Delta):
            raise InputError(
                f"material '{self.name}': has a delta lobe, which no density can represent;"
                " expected rough lobes only"
            )
        if mi.has_flag(flags, mi.BSDFFlags.Transmission):
            raise InputError(f"material '{self.name}': transmits light; expected a reflective BSDF")


def _varying_textures(mi: Any, bsdf: Any) -> list[tuple[str, Any]]:
    """Every spatially varying texture below ``bsdf``, by path, in a fixed order."""
    found, queue = [], [("", bsdf)]

    class Children(mi.TraversalCallback):
        def __init__(self, path: str):
            super().__init__()
            self.path = path

        def put_object(self, name: str, child: Any, *_: Any) -> None:
            queue.append((f"{self.path}.{name}", child))

        def put(self, name: str, child: Any, *_: Any) -> None:
            if isinstance(child, mi.Object):
                self.put_object(name, child)

        def put_value(self, *_: Any) -> None:
            pass

    while queue:
        path, node = queue.pop(0)
        if isinstance(node, mi.Texture):
            if node.is_spatially_varying():
                found.append((path, node))
        elif node is not None:
            node.traverse(Children(path))
    return sorted(found, key=lambda item: item[0])
