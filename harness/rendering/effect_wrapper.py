"""Any other BSDF of a scene, made to do only what the scene's effects call for, and counted.

Import this module after ``variant.use``: a Mitsuba class belongs to a variant.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from harness.effects.base import Recipe
from harness.rendering.meter import Meter
from harness.rendering.plugin import unweighed


class EffectWrapper(mi.BSDF):
    """``nested``, of which no light is sampled where the recipe says so, in its channels.

    It hands every call on, so it is slower than ``nested`` itself; :func:`needed` tells when
    it cannot be done without.
    """

    def __init__(self, nested: mi.BSDF, recipe: Recipe, meter: Meter | None = None):
        super().__init__(mi.Properties())
        self.nested, self.channels, self.meter = nested, recipe.channels, meter
        self.weighed = recipe.emitter_sampling or recipe.integrator == "direct"
        parts = [nested.flags(i) for i in range(nested.component_count())]
        if self.weighed:
            self.m_components, self.m_flags = parts, nested.flags()
        else:
            self.m_components = [unweighed(part) for part in parts]
            self.m_flags = unweighed(nested.flags())

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """See ``mitsuba.BSDF.sample``."""
        bs, value = self.nested.sample(ctx, si, sample1, sample2, active)
        if not self.weighed:
            bs.sampled_type = _as_specular(bs.sampled_type)
        if self.channels == 1:
            value = mi.Color3f(mi.luminance(value))
        if self.meter is not None:
            hit = mi.Mask(active) & si.is_valid()
            self.meter.bounced(hit, value)
            self.meter.add("samples", hit)
            self.meter.add("evaluations", hit)
            self.meter.add("values", hit, self.channels)
        return bs, value

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """See ``mitsuba.BSDF.eval``."""
        if not self.weighed:
            return mi.Color3f(0)
        return self._counted(self.nested.eval(ctx, si, wo, active), active, "evaluations")

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """See ``mitsuba.BSDF.pdf``."""
        if not self.weighed:
            return mi.Float(0)
        if self.meter is not None:
            self.meter.add("pdf-queries", mi.Mask(active) & si.is_valid())
        return self.nested.pdf(ctx, si, wo, active)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """See ``mitsuba.BSDF.eval_pdf``."""
        if not self.weighed:
            return mi.Color3f(0), mi.Float(0)
        value, pdf = self.nested.eval_pdf(ctx, si, wo, active)
        if self.meter is not None:
            self.meter.add("pdf-queries", mi.Mask(active) & si.is_valid())
        return self._counted(value, mi.Mask(active) & si.is_valid(), "evaluations"), pdf

    def eval_null_transmission(self, si: Any, active: Any = True) -> Any:
        """See ``mitsuba.BSDF.eval_null_transmission``."""
        return self.nested.eval_null_transmission(si, active)

    def traverse(self, callback: Any) -> None:
        """See ``mitsuba.Object.traverse``."""
        callback.put("nested", self.nested, mi.ParamFlags.Differentiable)

    def to_string(self) -> str:
        """For Mitsuba's messages."""
        return f"EffectWrapper[{self.nested.class_name()}]"

    def _counted(self, value: Any, active: Any, what: str) -> Any:
        if self.meter is not None:
            self.meter.add(what, active)
            self.meter.add("values", active, self.channels)
        return value if self.channels == 3 else mi.Color3f(mi.luminance(value))


def needed(recipe: Recipe, meter: Meter | None) -> bool:
    """Whether a BSDF of Mitsuba's own would do more than asked for, or has to be counted."""
    unlit = recipe.integrator != "direct" and not recipe.emitter_sampling
    return meter is not None or unlit or recipe.channels == 1


def _as_specular(sampled: Any) -> Any:
    """Kinds of sampled lobes, the smooth ones replaced by specular ones; null stays null."""
    reflects = mi.UInt32(+(mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection))
    passes = mi.UInt32(+(mi.BSDFFlags.DiffuseTransmission | mi.BSDFFlags.GlossyTransmission))
    found = dr.select((sampled & reflects) != 0, +mi.BSDFFlags.DeltaReflection, sampled)
    return dr.select((sampled & passes) != 0, +mi.BSDFFlags.DeltaTransmission, found)
