"""Mitsuba's emitters, counted: how many rays are sent to them, and how often asked for a pdf.

For renders that are counted only: they are slower. Import after ``variant.use``.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from harness.rendering.meter import Meter


class CountedLight(mi.Emitter):
    """Hands calls on to ``nested``, a light without a shape, and counts them."""

    meter: Meter | None = None

    def __init__(self, props: mi.Properties):
        super().__init__(props)
        self.nested = next(v for _, v in props.items() if isinstance(v, mi.Emitter))
        self.m_flags = self.nested.flags()

    def set_scene(self, scene: Any) -> None:
        """See ``mitsuba.Endpoint.set_scene``."""
        self.nested.set_scene(scene)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        """See ``mitsuba.Endpoint.sample_direction``; a ray follows wherever there is a density."""
        ds, weight = self.nested.sample_direction(it, sample, active)
        ds.emitter = mi.EmitterPtr(self)
        self._count("shadow-rays", mi.Mask(active) & (ds.pdf != 0))
        return ds, weight

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """See ``mitsuba.Endpoint.pdf_direction``."""
        pdf = self.nested.pdf_direction(it, ds, active)
        self._count("light-queries", mi.Mask(active) & (pdf == pdf))
        return pdf

    def eval(self, si: Any, active: Any = True) -> Any:
        """See ``mitsuba.Endpoint.eval``."""
        return self.nested.eval(si, active)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """See ``mitsuba.Emitter.eval_direction``."""
        return self.nested.eval_direction(it, ds, active)

    def bbox(self) -> Any:
        """See ``mitsuba.Endpoint.bbox``."""
        return self.nested.bbox()

    def to_string(self) -> str:
        """For Mitsuba's messages."""
        return f"CountedLight[{self.nested.class_name()}]"

    def _count(self, what: str, active: Any) -> None:
        if self.meter is not None:
            self.meter.add(what, active)


class CountedArea(CountedLight):
    """A shape that emits ``radiance`` from its front, as Mitsuba's ``area``, and is counted."""

    def __init__(self, props: mi.Properties):
        mi.Emitter.__init__(self, props)
        self.radiance = props.get_emissive_texture("radiance")
        self.m_flags = +mi.EmitterFlags.Surface

    def set_scene(self, scene: Any) -> None:
        """It has a shape, and needs to know no more."""

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        """See ``mitsuba.Endpoint.sample_direction``."""
        ds = self.get_shape().sample_direction(it, sample, active)
        lit = mi.Mask(active) & (dr.dot(ds.d, ds.n) < 0) & (ds.pdf != 0)
        ds.pdf = dr.select(lit, ds.pdf, 0)
        si = mi.SurfaceInteraction3f(ds, it.wavelengths)
        weight = dr.select(lit, self.radiance.eval(si, lit) / ds.pdf, 0)
        ds.emitter = mi.EmitterPtr(self)
        self._count("shadow-rays", lit)
        return ds, weight

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """See ``mitsuba.Endpoint.pdf_direction``."""
        self._count("light-queries", mi.Mask(active) & (ds.pdf == ds.pdf))
        pdf = self.get_shape().pdf_direction(it, ds, active)
        return dr.select(dr.dot(ds.d, ds.n) < 0, pdf, 0)

    def eval(self, si: Any, active: Any = True) -> Any:
        """See ``mitsuba.Endpoint.eval``."""
        return dr.select(si.wi.z > 0, self.radiance.eval(si, active), 0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """See ``mitsuba.Emitter.eval_direction``."""
        si = mi.SurfaceInteraction3f(ds, it.wavelengths)
        return dr.select(dr.dot(ds.d, ds.n) < 0, self.radiance.eval(si, active), 0)

    def bbox(self) -> Any:
        """See ``mitsuba.Endpoint.bbox``."""
        return self.get_shape().bbox()

    def to_string(self) -> str:
        """For Mitsuba's messages."""
        return "CountedArea[]"


mi.register_emitter("counted-light", CountedLight)
mi.register_emitter("counted-area", CountedArea)
