"""Any Mitsuba BSDF as a material."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.columns.material import ColumnMaterial
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.materials import mitsuba_refusals, surface_inputs
from harness.materials.mitsuba_textures import Features, varying
from harness.mitsuba_runtime import mitsuba_xml
from harness.mitsuba_runtime.bitmaps import with_bitmaps

EXTENT = 4.0
"""A fit draws |dp_du| and |dp_dv|, lengths of a unit of texture, from 1/EXTENT to EXTENT."""


def mitsuba() -> Any:
    """Mitsuba with a variant: the one that is set, or else that of the CPU."""
    import mitsuba as mi

    if mi.variant() is None:
        from harness.mitsuba_runtime.variant import use

        use("cpu")
    return mi


class MitsubaMaterial(ColumnMaterial):
    """A reflective Mitsuba BSDF.

    ``bsdf`` is a Mitsuba dictionary, in which ``{"type": "bitmap", "array": ndarray}`` stands
    for a bitmap of those texels, or a BSDF that is loaded already. Every spatially varying
    texture below it becomes features: its value at (u, v), one column per channel that
    varies. The condition is ``[u, v, features, wi.xy]`` with textures, ``[wi.xy]`` without.

    A BSDF with bump maps reads the derivatives of the position, too, for a slope is a height over
    a length: the condition is then ``[u, v, dp_du.xy, dp_dv.xy, features, wi.xy]``, in the local
    frame, and the features are tilted normals instead of heights. Random conditions draw the two
    lengths log-uniformly (:data:`EXTENT`), at right angles.

    It gives the effect ``texture`` where all its textures are bitmaps: without it each is the
    mean of its texels. For that a second BSDF is made, from the dictionary or by ``again()``.

    Raises:
        InputError: the BSDF cannot be loaded, transmits, has a delta lobe (which no density on
            the disk represents), or reads what no condition carries.
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
        mi = mitsuba()
        if isinstance(bsdf, dict):
            again = lambda: mi.load_dict(with_bitmaps(mi, bsdf))  # noqa: E731
        try:
            self.bsdf = again() if isinstance(bsdf, dict) else bsdf
        except RuntimeError as error:
            reason = mitsuba_xml.said(str(error))
            if "not found" in reason.lower():
                reason += "; a plugin of your own in Python is named file.py:Class"
            raise InputError(f"material '{name}': Mitsuba cannot load it: {reason}") from None
        self._again, self._plain = again, None
        mitsuba_refusals.check_kind(mi, self.bsdf, name)
        seen = surface_inputs.look(mi, self.bsdf)
        mitsuba_refusals.check_seen(seen, name)
        self.both_sides = seen.both_sides
        self.carries_derivatives = surface_inputs.DERIVATIVES in seen.reads
        self._features = Features(mi, self.bsdf, self.carries_derivatives)
        self.n_features = len(self._features)
        textures = varying(mi, self.bsdf)
        self.n_address = 6 if self.carries_derivatives else 2 if textures else 0
        if self.bsdf.needs_differentials():  # data of a mesh, without a texture
            self.n_address = max(self.n_address, 2)
        bitmaps = all("data" in mi.traverse(texture) for _, texture in textures)
        self.effects = frozenset({"texture"} if textures and bitmaps and again else ())

    def with_effects(self, effects: frozenset[str]) -> Material:
        """See :meth:`Material.with_effects`; without ``texture``, every texture is its mean.

        Features are then the same everywhere, and the place on the material is of no account.
        """
        if "texture" in effects or not self.effects:
            return self
        if self._plain is None:
            mi = mitsuba()
            plain = copy.copy(self)
            plain.bsdf, plain.effects = self._again(), frozenset()
            for _, texture in varying(mi, plain.bsdf):
                texels = mi.traverse(texture)
                mean = np.array(texels["data"]).mean((0, 1), keepdims=True, dtype=np.float64)
                texels["data"] = mi.TensorXf(mean.astype(np.float32))
                texels.update()
            plain._features = self._features.rebound(mi, plain.bsdf)
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
        """See :meth:`Material.places`; a unit of texture is a unit of length."""
        return self._places(uv, uv.new_ones(len(uv), 2))

    def conditions(self, n: int, generator: torch.Generator, device: str = "cpu") -> Tensor:
        """See :meth:`Material.conditions`; derivatives are drawn where they are carried."""
        if not self.carries_derivatives:
            return super().conditions(n, generator, device)
        u = torch.rand(n, 6, generator=generator).to(device)
        lengths = torch.exp((2 * u[:, 4:] - 1) * math.log(EXTENT))
        return torch.cat([self._places(u[:, :2], lengths), square_to_disk(u[:, 2:4])], 1)

    def eval_columns(self, c: Columns, wo: Columns) -> Any:
        """BSDF without cosine over columns: a Mitsuba colour."""
        mi = mitsuba()
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
        mi = mitsuba()
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
        if self.carries_derivatives:
            si.dp_du, si.dp_dv = mi.Vector3f(c[2], c[3], 0), mi.Vector3f(c[4], c[5], 0)
        return si

    def native_sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """The BSDF's own sampler: ``(x, y, pdf per disk area)``; invalid samples off the disk."""
        mi = mitsuba()
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
        mi = mitsuba()
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
        found = [si.uv.x, si.uv.y]
        if self.carries_derivatives:
            # What of them lies along the normal changes no slope.
            du, dv = si.to_local(si.dp_du), si.to_local(si.dp_dv)
            found += [du.x, du.y, dv.x, dv.y]
        return found + self._features(si)

    def _places(self, uv: Tensor, lengths: Tensor) -> Tensor:
        """Address and features where dp_du and dp_dv have ``lengths`` [N, 2] along x and y."""
        if not self.n_address or len(uv) == 0:
            return uv.new_empty(len(uv), self.n_address + self.n_features)
        mi = mitsuba()
        si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
        si.uv = mi.Point2f(*columns_of(uv))
        si.n = mi.Normal3f(0, 0, 1)
        si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
        x, y = columns_of(lengths)
        si.dp_du, si.dp_dv = mi.Vector3f(x, 0, 0), mi.Vector3f(0, y, 0)
        return tensor_of(*self._place(si), rows=len(uv))
