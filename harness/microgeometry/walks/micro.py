"""Micro-BSDFs: what a surface of microgeometry does with a particle, by sampling alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from harness.core.protocol.errors import InputError, nearest
from harness.mitsuba_runtime.bitmaps import with_bitmaps

WORDS: Mapping[str, Mapping[str, Any]] = {
    "lambertian": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
    "rough-conductor": {
        "type": "roughconductor",
        "distribution": "ggx",
        "alpha": 0.05,
        "material": "none",
    },
    "mirror": {"type": "conductor", "material": "none"},
}
"""White ones: what is coloured about a surface is its tint."""

_SAMPLES = 4096


@dataclass(frozen=True)
class MicroBSDF:
    """A Mitsuba BSDF that samples itself, and the share of each channel that it keeps.

    ``bsdf`` is a Mitsuba dictionary (texel arrays as in :mod:`harness.textures`); ``reflectance``
    multiplies its weights, so that a white word can be coloured.
    """

    bsdf: Mapping[str, Any]
    reflectance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    where: str = field(default="micro", compare=False)

    @classmethod
    def of(cls, data: Any, where: str) -> MicroBSDF:
        """From a word, or a mapping with ``bsdf`` (a word or a Mitsuba dictionary) and more."""
        if isinstance(data, str):
            return cls(_named(data, where), where=where)
        return cls(_named(data["bsdf"], where), data.get("reflectance", (1.0, 1.0, 1.0)), where)

    def load(self, mi: Any) -> Any:
        """The Mitsuba BSDF; :class:`InputError` if it is none, transmits or cannot sample."""
        try:
            bsdf = mi.load_dict(with_bitmaps(mi, dict(self.bsdf)))
        except RuntimeError as error:
            text = str(error).strip().splitlines()[-1].strip()
            raise InputError(f"{self.where}: Mitsuba refuses the BSDF: {text}") from None
        if not isinstance(bsdf, mi.BSDF):
            raise InputError(f"{self.where}: expected a BSDF, got a {type(bsdf).__name__}")
        if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission):
            raise InputError(
                f"{self.where}: '{self.bsdf['type']}' transmits; expected a reflection, for"
                " primitives are solid"
            )
        self._try(mi, bsdf)
        return bsdf

    def _try(self, mi: Any, bsdf: Any) -> None:
        """Draw from it at one direction."""
        import drjit as dr

        si = dr.zeros(mi.SurfaceInteraction3f, _SAMPLES)
        si.sh_frame, si.n = mi.Frame3f(mi.Normal3f(0, 0, 1)), mi.Normal3f(0, 0, 1)
        si.wi = dr.normalize(mi.Vector3f(0.3, 0.2, 1))
        random = mi.PCG32(size=_SAMPLES)
        u = mi.Point2f(random.next_float32(), random.next_float32())
        try:
            taken, weight = bsdf.sample(mi.BSDFContext(), si, random.next_float32(), u)
            found = np.concatenate([np.array(taken.wo), np.array(weight)])
        except (RuntimeError, NotImplementedError, TypeError) as error:
            text = str(error).strip().splitlines()[-1].strip()
            raise InputError(
                f"{self.where}: '{self.bsdf['type']}' cannot sample itself: {text}"
            ) from None
        if not np.isfinite(found).all():
            raise InputError(f"{self.where}: '{self.bsdf['type']}' samples no finite directions")
        if not (found[3:] > 0).any() or max(self.reflectance) <= 0:
            raise InputError(
                f"{self.where}: '{self.bsdf['type']}' absorbs every particle, so that there is"
                " nothing to learn; expected some reflectance"
            )


def _named(bsdf: Any, where: str) -> Mapping[str, Any]:
    if isinstance(bsdf, str):
        if bsdf not in WORDS:
            raise InputError(f"{where}: unknown micro-BSDF '{bsdf}'{nearest(bsdf, WORDS)}")
        return WORDS[bsdf]
    if not isinstance(bsdf, Mapping) or not isinstance(bsdf.get("type"), str):
        raise InputError(
            f"{where}: bsdf: expected {', '.join(WORDS)} or a Mitsuba BSDF with its 'type',"
            f" got {bsdf!r}"
        )
    return bsdf
