"""A fitted method and its material as one Mitsuba BSDF.

Import this module after ``variant.use``: a Mitsuba class belongs to a variant.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import torch

from harness.core.columns.bridge import Columns, columns_of, tensor_of
from harness.core.columns.method import ColumnMethod
from harness.core.protocol.disk import luminance
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.effects.base import Recipe
from harness.rendering import passes
from harness.rendering.meter import Meter

_OFFERED: dict[str, mi.BSDF] = {}
_WRAP: list[Any] = []


def _one_condition(query: Callable[..., Any]) -> Callable[..., Any]:
    """Have the steps of a query share one condition, where a material's lookup is dear.

    With a meter on, each step makes its own, so that what it costs is counted.
    """

    @functools.wraps(query)
    def wrapped(self: SampledBSDF, ctx: Any, si: Any, *arguments: Any) -> Any:
        if self.meter is not None or not self.eval_in_columns or self._untraceable():
            return query(self, ctx, si, *arguments)
        self.shared = self._condition(si)
        try:
            return query(self, ctx, si, *arguments)
        finally:
            self.shared = None

    return wrapped


class SampledBSDF(mi.BSDF):
    """``material`` evaluated by itself, sampled by ``method``; usable in any scene.

    Reflective; from behind black, unless the material is the same from both sides. Mitsuba's
    value of ``sample`` is f cos / pdf with the pdf per solid angle, cos times the method's; or
    the method's own weight, if its pdf is no more than an approximation, which then only weighs
    strategies. A sample off the disk has pdf 0 and value 0; what is not a number, or a density that
    is negative or infinite, becomes infinite, so that a broken method shows in the image.

    Render it through :mod:`harness.rendering.passes`, which has Mitsuba evaluate BSDF calls
    one material at a time; a method in torch cannot run inside a symbolic call.
    """

    def __init__(self, material: Material, method: Method):
        super().__init__(mi.Properties())
        self.material, self.method = material, method
        self.own_eval = type(method).eval is not Method.eval
        self.in_columns = isinstance(method, ColumnMethod)
        self.nested = material.mitsuba_bsdf()
        self.eval_in_columns = self.nested is None and material.renders_in_columns
        self.symbolic = (
            self.in_columns and self.nested is not None and not self.own_eval
        ) and method.in_one_kernel
        self.both_sides = material.both_sides
        self.shared: Columns | None = None
        self.spread = 0.0
        self.meter: Meter | None = None
        self.channels, self.weighed = 3, True
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        if material.n_address + material.n_features:
            flags = flags | mi.BSDFFlags.SpatiallyVarying
        if self.both_sides:
            flags = flags | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = self.lobe = flags

    def follow(self, recipe: Recipe, meter: Meter | None = None) -> None:
        """Do what ``recipe`` asks for and no more. To be called before a scene is built.

        Without light sampling nobody asks for a density. Mitsuba's path tracers sample lights
        at every surface that is not perfectly specular, so that is what this one then claims
        to be: no ray goes to a light, nothing is evaluated for it, and a light that is met
        counts in full.
        """
        self.channels, self.meter = recipe.channels, meter
        self.weighed = recipe.emitter_sampling or recipe.integrator == "direct"
        if not self.weighed:
            self.lobe = unweighed(self.m_flags)
            self.m_components, self.m_flags = [self.lobe], self.lobe

    @_one_condition
    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """A direction from three uniforms, and f cos / pdf."""
        if self._untraceable():
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.pdf, bs.eta = mi.Vector3f(0, 0, 1), 1, 1
            return bs, mi.Color3f(dr.inf)
        si, turned = self.facing(si)
        front = mi.Mask(active) & (si.wi.z > 0)
        x, y, pdf, *weight = self._draw(si, [sample1, sample2.x, sample2.y], front)
        # A density is finite and not negative; what is none takes part in no guard below.
        broken = front & (dr.isnan(x) | dr.isnan(y) | ~((pdf >= 0) & (pdf < dr.inf)))
        cos_squared = 1 - x * x - y * y
        valid = front & ~broken & (cos_squared > 0) & (pdf > 0)
        usable = valid | broken
        # Integrators drop samples whose density or value is nan, and the image would look
        # fine. Infinity they keep.
        cos = dr.select(valid, dr.sqrt(cos_squared), 1)
        bs = mi.BSDFSample3f()
        bs.wo = mi.Vector3f(dr.select(valid, x, 0), dr.select(valid, y, 0), cos)
        bs.pdf = dr.select(valid, pdf * cos, dr.select(usable, 1, 0))
        bs.eta = 1
        reflects = mi.BSDFFlags.GlossyReflection if self.weighed else mi.BSDFFlags.DeltaReflection
        bs.sampled_type = mi.UInt32(+reflects)
        bs.sampled_component = mi.UInt32(0)
        if weight:
            value = mi.Color3f(*weight)
            value = value if self.channels == 3 else mi.Color3f(mi.luminance(value))
            value = dr.select(valid, value, 0)
        else:
            value = dr.select(valid, self._value(ctx, si, bs.wo, valid) / bs.pdf, 0)
        value = dr.select(broken | dr.any(dr.isnan(value)), dr.inf, value)
        if self.meter is not None:
            self.meter.sampled(mi.Mask(active) & si.is_valid(), value)
        bs.wo = turned(bs.wo)
        return bs, value

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """f cos."""
        if not self.weighed:
            return mi.Color3f(0)
        if self._untraceable():
            return mi.Color3f(dr.inf)
        si, turned = self.facing(si)
        wo = turned(wo)
        return self._value(ctx, si, wo, self._above(si, wo, active))

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Density per solid angle of :meth:`sample`."""
        if not self.weighed:
            return mi.Float(0)
        if self._untraceable():
            return mi.Float(dr.inf)
        si, turned = self.facing(si)
        wo = turned(wo)
        above = self._above(si, wo, active)
        return dr.select(above, self._density(si, wo, above) * wo.z, 0)

    @_one_condition
    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Both, as multiple importance sampling asks for them."""
        value, pdf = self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)
        # A weight that is nan counts as zero, and hides where it came from. Density zero gives
        # the light's strategy, and with it infinity, the weight one.
        broken = ~((pdf >= 0) & (pdf < dr.inf)) | dr.any(dr.isnan(value))
        return dr.select(broken, dr.inf, value), dr.select(broken, 0, pdf)

    def to_string(self) -> str:
        """For Mitsuba's messages."""
        return f"SampledBSDF[{self.material.name}, {self.method.name}]"

    def facing(self, si: Any) -> tuple[Any, Callable[[Any], Any]]:
        """``si`` seen from the front, and what turns local directions to that side and back."""
        if not self.both_sides:
            return si, lambda direction: direction
        behind = si.wi.z < 0
        front = mi.SurfaceInteraction3f(si)
        front.wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        return front, lambda d: mi.Vector3f(d.x, d.y, dr.select(behind, -d.z, d.z))

    def _untraceable(self) -> bool:
        """Whether a symbolic call is being traced in which this pair takes no part.

        Dr.Jit traces a call through every BSDF alive, whether or not it is in the scene that
        is rendered. The harness renders such a scene in evaluated mode, so it is another's call;
        what is then returned is infinite, and no image with it looks fine. Anybody else is told.
        """
        evaluated = self.nested is not None or self.eval_in_columns
        in_dr_jit = self.in_columns and evaluated and not self.own_eval
        if not dr.flag(dr.JitFlag.SymbolicScope):
            return False
        if in_dr_jit:
            # In a scene that the harness renders so there is no such one: a network would be
            # compiled into the kernel for nothing.
            return passes.rendering() and not self.symbolic
        if not passes.rendering():
            raise RuntimeError(
                f"'{self.method.name}' on '{self.material.name}' runs in PyTorch, which cannot be"
                " traced into a symbolic call: render within"
                " harness.rendering.passes.evaluated_mode(), or after"
                " drjit.set_flag(drjit.JitFlag.SymbolicCalls, False) and the same for"
                " SymbolicLoops (any render traces every BSDF that is alive)"
            )
        return True

    @staticmethod
    def _above(si: Any, wo: Any, active: Any) -> Any:
        return mi.Mask(active) & (si.wi.z > 0) & (wo.z > 0)

    def _condition(self, si: Any) -> Columns:
        if self.shared is not None:
            return self.shared
        if self.material.prefilters:
            return self.material.condition_columns(si, self.spread)
        if callable(getattr(self.material, "condition_columns", None)):
            return self.material.condition_columns(si)
        n = dr.width(si.wi)
        uv = tensor_of(*_full([si.uv.x, si.uv.y], n), rows=n)
        return [*columns_of(self.material.places(uv)), si.wi.x, si.wi.y]

    def _draw(self, si: Any, u: Columns, active: Any) -> tuple[Any, ...]:
        """``(x, y, pdf)``, and three weights where the method's pdf is not exact."""
        if self.meter is None:
            return self._draw_bare(si, u, active)
        return self.meter.during("sample", active, [si, u], lambda: self._draw_bare(si, u, active))

    def _draw_bare(self, si: Any, u: Columns, active: Any) -> tuple[Any, ...]:
        c = self._condition(si)
        exact = self.method.exact_pdf
        if self.in_columns:
            if exact:
                return self.method.sample_columns(c, u)
            x, y, pdf, weight = self.method.sample_weighted_columns(c, u)
            return x, y, pdf, *weight

        def draw(rows: torch.Tensor) -> torch.Tensor:
            pair = rows[:, : len(c)], rows[:, len(c) :]
            drawn = self.method.sample(*pair) if exact else self.method.sample_weighted(*pair)
            wo, pdf, *weight = drawn
            return torch.cat([wo, pdf[:, None], *weight], 1)

        return tuple(_on_active_rows(draw, [*c, *u], active, outputs=3 if exact else 6))

    def _density(self, si: Any, wo: Any, active: Any) -> Any:
        if self.meter is None:
            return self._density_bare(si, wo, active)
        return self.meter.during(
            "pdf", active, [si, wo], lambda: self._density_bare(si, wo, active)
        )

    def _density_bare(self, si: Any, wo: Any, active: Any) -> Any:
        c = self._condition(si)
        if self.in_columns:
            return self.method.pdf_columns(c, [wo.x, wo.y])

        def density(rows: torch.Tensor) -> torch.Tensor:
            return self.method.pdf(rows[:, : len(c)], rows[:, len(c) :])[:, None]

        return _on_active_rows(density, [*c, wo.x, wo.y], active, outputs=1)[0]

    def _value(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        if self.meter is None:
            return self._value_bare(ctx, si, wo, active)
        self.meter.add("values", active, self.channels)
        return self.meter.during(
            "eval", active, [si, wo], lambda: self._value_bare(ctx, si, wo, active)
        )

    def _value_bare(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        if self.nested is not None and not self.own_eval:
            value = self.nested.eval(ctx, si, wo, active)
            return value if self.channels == 3 else mi.Color3f(mi.luminance(value))
        c = self._condition(si)
        if self.eval_in_columns and not self.own_eval:
            rgb = mi.Color3f(*self.material.eval_columns(c, [wo.x, wo.y]))
            rgb = rgb if self.channels == 3 else mi.Color3f(mi.luminance(rgb))
            return dr.select(active, rgb * wo.z, 0)

        def value(rows: torch.Tensor) -> torch.Tensor:
            condition, direction = rows[:, : len(c)], rows[:, len(c) :]
            if self.channels == 3:
                return self.method.eval(condition, direction)
            if self.own_eval:
                return luminance(self.method.eval(condition, direction))[:, None]
            return self.material.eval_luminance(condition, direction)[:, None]

        f = _on_active_rows(value, [*c, wo.x, wo.y], active, outputs=self.channels)
        # One channel is one number three times over, which Dr.Jit computes once.
        return dr.select(active, mi.Color3f(*(f if self.channels == 3 else 3 * f)) * wo.z, 0)


def unweighed(flags: Any) -> Any:
    """``flags`` of a BSDF of which no light is to be sampled: its lobes, as if specular."""
    smooth = (
        (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.DeltaReflection),
        (mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DeltaReflection),
        (mi.BSDFFlags.DiffuseTransmission, mi.BSDFFlags.DeltaTransmission),
        (mi.BSDFFlags.GlossyTransmission, mi.BSDFFlags.DeltaTransmission),
    )
    flags = int(flags)
    for lobe, specular in smooth:
        if flags & int(lobe):
            flags = flags & ~int(lobe) | int(specular)
    return flags


def _full(columns: Columns, n: int) -> Columns:
    """Every column at full width: one that is the same in all rows may be of width one."""
    return [c if dr.width(c) == n else dr.repeat(c, n) for c in columns]


def _on_active_rows(function: Any, columns: Columns, active: Any, outputs: int) -> Columns:
    """``function`` [n, C] -> [n, outputs] on the active rows; zero in the others."""
    n = max(dr.width(c) for c in columns)
    columns = _full(columns, n)
    results = [dr.zeros(mi.Float, n) for _ in range(outputs)]
    lanes = dr.compress(active if dr.width(active) == n else active & dr.full(mi.Mask, True, n))
    if dr.width(lanes) == 0:
        return results
    if dr.width(lanes) == 1:
        # What is one wide Dr.Jit broadcasts to the mask of the call it is in; twice the one row
        # is as right.
        lanes = dr.repeat(lanes, 2)
    picked = [dr.gather(mi.Float, c, lanes) for c in columns]
    with torch.inference_mode():
        out = function(tensor_of(*picked, rows=dr.width(lanes)))
    for target, column in zip(results, columns_of(out), strict=True):
        dr.scatter(target, column, lanes)
    return results


@contextlib.contextmanager
def offered(
    bsdfs: Mapping[str, mi.BSDF], wrap: Callable[[mi.BSDF], mi.BSDF] | None = None
) -> Iterator[None]:
    """What a scene file that is loaded in the block may refer to.

    Each of ``bsdfs`` is ``<bsdf type="harness"><string name="key" .../>``, and what ``wrap``
    makes of another BSDF is ``<bsdf type="harness-effect-wrapper">`` around that one.
    """
    _OFFERED.update(bsdfs)
    _WRAP[:] = [wrap]
    try:
        yield
    finally:
        # What stays alive is compiled into every symbolic kernel.
        _OFFERED.clear()
        _WRAP.clear()


def _wrapped(props: Any) -> mi.BSDF:
    nested = (value for _, value in props.items())
    return _WRAP[0](next(value for value in nested if isinstance(value, mi.BSDF)))


mi.register_bsdf("harness", lambda props: _OFFERED[props["key"]])
mi.register_bsdf("harness-effect-wrapper", _wrapped)
