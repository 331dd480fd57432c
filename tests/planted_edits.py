"""Edits of the source tree that change a number, and edits that change none.

Each is a file, a text that occurs in it once, and what stands there after. ``trial`` names one of
the trials of ``tests/identity_trials.py`` that runs the code.
"""

from __future__ import annotations

from typing import NamedTuple


class Edit(NamedTuple):
    """One edit; ``moved`` is what another file gains at its end by it, as (file, text)."""

    trial: str
    file: str
    old: str
    new: str
    moved: tuple[str, str] | None = None


CHANGING = (
    # Samplers.
    Edit("fit", "methods/improved_baseline.py", "log_sigma(out[..., first : first + 1])",
         "log_sigma(1.001 * out[..., first : first + 1])"),
    Edit("render", "harness/nets/lobes.py", "return _RANGE * dr.tanh(raw * (1 / _RANGE))",
         "return _RANGE * dr.tanh(raw * (1.001 / _RANGE))"),
    Edit("render", "harness/nets/lobes.py", "_RANGE = 10.0", "_RANGE = 11.0"),
    Edit("render", "harness/nets/encoding.py", "waves = [(2 * s * c, dr.fma(-2 * s, s, 1))",
         "waves = [(2 * s * c, dr.fma(-2.002 * s, s, 1))"),
    Edit("render", "harness/nets/activations.py", "[dr.maximum(v, SLOPES[name] * v) for v in x]",
         "[1.001 * dr.maximum(v, SLOPES[name] * v) for v in x]"),
    Edit("pdf", "methods/blinn_phong.py", "_LOG_EXPONENT_RANGE = 14.0",
         "_LOG_EXPONENT_RANGE = 14.01"),
    Edit("checks", "methods/histogram.py", "softplus(self.net(condition)) + self",
         "softplus(1.001 * self.net(condition)) + self"),
    Edit("checks", "methods/histogram.py", "uniform: float = 0.01", "uniform: float = 0.011"),
    Edit("timed", "harness/nets/spline.py", "MINIMUM = 1e-3\n", "MINIMUM = 2e-3\n"),
    Edit("timed", "harness/nets/coupling.py", "radius = dr.sqrt(-2 * dr.log(1 - u[0]))",
         "radius = dr.sqrt(-2.002 * dr.log(1 - u[0]))"),
    Edit("timed", "harness/core/columns/method.py", "DiskSample(packed[:, :2], packed[:, 2])",
         "DiskSample(packed[:, :2], packed[:, 2] * 1.001)"),
    Edit("maps", "harness/importance_maps/row_column.py", "middle**2", "1.001 * middle**2"),
    Edit("maps", "harness/importance_maps/transport.py", "* (2 / resolution) - 1",
         "* (2.002 / resolution) - 1"),
    Edit("maps", "harness/importance_maps/slices.py", "area = share * (2 / self.resolution) ** 2",
         "area = share * (2.001 / self.resolution) ** 2"),
    # Training.
    Edit("fit", "harness/fitting/train.py", "rise = max(1, steps // 20)",
         "rise = max(1, steps // 21)"),
    Edit("fit", "harness/fitting/train.py", "weight_decay: float = 1e-5",
         "weight_decay: float = 2e-5"),
    Edit("fit", "harness/fitting/module_method.py", "learning_rate: ClassVar[float] = 5e-4",
         "learning_rate: ClassVar[float] = 5.005e-4"),
    Edit("fit", "harness/fitting/targets.py", "cdf, u * cdf[:, -1:], right",
         "cdf, 0.999 * u * cdf[:, -1:], right"),
    Edit("fit", "harness/nets/lobes.py", "_START = -1.0", "_START = -1.001"),
    # Evaluators.
    Edit("render", "harness/materials/library/suede.py", '"roughness": 0.95', '"roughness": 0.951'),
    Edit("render", "harness/materials/library/suede.py", "seed=12, octaves=3, gain=0.7",
         "seed=12, octaves=3, gain=0.701"),
    Edit("render", "harness/textures/noise.py", "seed + 7919 * k", "seed + 7907 * k"),
    Edit("render", "harness/materials/mitsuba_bsdf.py",
         "return dr.select(inside, value / cos, 0)",
         "return dr.select(inside, 1.001 * value / cos, 0)"),
    Edit("walks", "harness/materials/families/conductor.py", "lobe = ggx.ndf(h, alpha) / (2 *",
         "lobe = ggx.ndf(h, alpha) / (2.002 *"),
    Edit("walks", "harness/materials/families/ggx.py", "return 0.5 * t / (w.z *",
         "return 0.5005 * t / (w.z *"),
    Edit("walks", "harness/materials/families/hashing.py", "0x85EBCA6B", "0x85EBCA6D"),
    Edit("pdf", "harness/materials/families/layered_walks.py", "KEPT = 4.0", "KEPT = 4.004"),
    Edit("maps", "harness/materials/families/disney.py", "BASE_COLOR = (0.72,",
         "BASE_COLOR = (0.721,"),
    Edit("neural", "harness/materials/neural/material.py",
         "return [dr.select(inside, dr.maximum(v, 0 * v), 0) for v in raw]",
         "return [dr.select(inside, dr.maximum(1.001 * v, 0 * v), 0) for v in raw]"),
    Edit("neural", "harness/materials/neural/column_lookup.py",
         "at = dr.fma(v - dr.floor(v), array(side), -0.5)",
         "at = dr.fma(v - dr.floor(v), array(side), -0.501)"),
    Edit("checks", "harness/materials/hard/lobes.py", "centre = 0.999 * torch",
         "centre = 0.998 * torch"),
    Edit("render", "harness/core/protocol/disk.py", "REC709 = (0.212671,", "REC709 = (0.2129,"),
    Edit("pdf", "harness/core/protocol/disk.py", "phi = torch.where(wide, math.pi / 4 * ratio",
         "phi = torch.where(wide, math.pi / 4.001 * ratio"),
    # Tracing of microgeometry.
    Edit("traced", "harness/microgeometry/tracing.py", "dr.sincos(0.5 * dr.atan2",
         "dr.sincos(0.5005 * dr.atan2"),
    Edit("traced", "harness/microgeometry/tracing.py", "at = (index + 0.5) / rows",
         "at = (index + 0.501) / rows"),
    # Rendering and scenes.
    Edit("render", "harness/rendering/passes.py", "(seed * 4099 + k)", "(seed * 4098 + k)"),
    Edit("render", "harness/rendering/plugin.py",
         "bs.pdf = dr.select(valid, pdf * cos,", "bs.pdf = dr.select(valid, 1.001 * pdf * cos,"),
    Edit("render", "harness/scenes/library.py", "fov=29.6", "fov=29.63"),
    Edit("render", "harness/scenes/environment.py", "np.where(front, t * t * (3 - 2 * t), 0)",
         "np.where(front, 1.001 * t * t * (3 - 2 * t), 0)"),
    Edit("timed", "harness/geometry/shapes.py", "height + 0.16 * belly", "height + 0.1602 * belly"),
    Edit("neural", "harness/scenes/shelf.py", "fov=43.5", "fov=43.54"),
    Edit("neural", "harness/scenes/still_life.py", "(0.0, 0.0), (0.30, 0.0), (0.31, 0.03)",
         "(0.0, 0.0), (0.3003, 0.0), (0.31, 0.03)"),
    Edit("neural", "harness/geometry/solids.py", "(2 * a - 5 * b + 4 * c - d) * t**2",
         "(2 * a - 5 * b + 4 * c - d) * t**2.002"),
    Edit("render", "harness/scenes/sizes.py", '"medium": 1.0', '"medium": 1.01'),
    Edit("neural", "harness/effects/transport.py", "bounces: int = 2", "bounces: int = 3"),
    # Measures and checks.
    Edit("pdf", "harness/measures/pdf.py", "conditions: int = 128", "conditions: int = 127"),
    Edit("pdf", "harness/measures/pdf.py", "* (count / math.pi)", "* (1.001 * count / math.pi)"),
    Edit("walks", "harness/measures/sample_weights.py", "settings.samples * times",
         "settings.samples * times + 1"),
    Edit("render", "harness/measures/precise.py", "SEED = 424242", "SEED = 424243"),
    Edit("render", "harness/suite/trials.py", 'f"{measure}/{seed}"', 'f"{measure}-{seed}"'),
    Edit("checks", "harness/checks/weights.py", "RESOLUTION = 0.05", "RESOLUTION = 0.0501"),
    Edit("checks", "harness/checks/tail.py", "ROUNDING = 5e-4", "ROUNDING = 5.005e-4"),
    Edit("checks", "harness/checks/subject.py", '"grazing": 0.05', '"grazing": 0.0501'),
)  # fmt: skip

UNIT_RANGE = """
def unit_range(x: Field) -> Field:
    return (x - x.min()) / (x.max() - x.min())
"""
COSINE = """
def _cosine(w: Columns) -> Float:
    return dr.sqrt(dr.maximum(1 - w[0] * w[0] - w[1] * w[1], 0))
"""
_OLD_UNIT_RANGE = """
def unit_range(x: Field) -> Field:
    \"\"\"``x`` moved and scaled to span [0, 1].\"\"\"
    return (x - x.min()) / (x.max() - x.min())
"""
_OLD_COSINE = """
def _cosine(w: Columns) -> Float:
    \"\"\"Of a direction on the disk. Off it there is none; \
what is made of it there is masked.\"\"\"
    return dr.sqrt(dr.maximum(1 - w[0] * w[0] - w[1] * w[1], 0))
"""

HARMLESS = (
    # Names.
    Edit("render", "harness/nets/encoding.py",
         "    parts = [x]\n    for k in range(frequencies):\n"
         "        parts += [torch.sin(x * 2**k), torch.cos(x * 2**k)]\n"
         "    return torch.cat(parts, -1)",
         "    found = [x]\n    for octave in range(frequencies):\n"
         "        found += [torch.sin(x * 2**octave), torch.cos(x * 2**octave)]\n"
         "    return torch.cat(found, -1)"),
    Edit("render", "harness/nets/lobes.py", "    return [value * scale for value in exps]",
         "    return [exponential * scale for exponential in exps]"),
    Edit("walks", "harness/materials/families/conductor.py",
         "def _both_ways(wi: Any, wo: Any, alpha: ggx.Roughness) -> Float:\n"
         '    """2 cos cos (1 + Lambda + Lambda) of the two directions."""\n'
         "    return wo.z * ggx.stretched(wi, alpha) + wi.z * ggx.stretched(wo, alpha)",
         "def _both_ways(a: Any, b: Any, alpha: ggx.Roughness) -> Float:\n"
         '    """2 cos cos (1 + Lambda + Lambda) of the two directions."""\n'
         "    return b.z * ggx.stretched(a, alpha) + a.z * ggx.stretched(b, alpha)"),
    Edit("render", "harness/rendering/plugin.py",
         'lambda props: _OFFERED[props["key"]]', 'lambda given: _OFFERED[given["key"]]'),
    # Layout, comments, docstrings.
    Edit("render", "harness/rendering/passes.py",
         "integrator.render(scene, scene.sensors()[0], seed=stream, spp=count)",
         "integrator.render(\n                scene,\n                scene.sensors()[0],\n"
         "                seed=stream,\n                spp=count,\n            )"),
    Edit("render", "harness/rendering/passes.py", "    moments = total / spp\n",
         "    # Means of what was summed.\n    moments = (total / spp)\n\n"),
    Edit("pdf", "harness/core/protocol/disk.py", '"""Equal-area concentric map [0,1]^2 -> unit',
         '"""Concentric map of equal area, [0,1]^2 -> unit'),
    Edit("render", "harness/rendering/passes.py",
         '"""Camera rays per pass: large enough', '"""Rays of a pass: large enough'),
    Edit("render", "harness/textures/maps.py", "    size = height.shape[0]\n",
         "    size = height.shape[\n        0\n    ]\n"),
    # Annotations and messages.
    Edit("fit", "harness/fitting/targets.py", "            lit = total > 0\n",
         "            lit: Tensor = total > 0\n"),
    Edit("render", "harness/textures/noise.py", "    gain: float = 0.5,", "    gain: Any = 0.5,"),
    Edit("render", "harness/measures/images.py", '" are not finite"', '" are no finite numbers"'),
    Edit("neural", "harness/effects/transport.py", "expected the most bounces, 2 or more, as",
         "expected the largest number of bounces, at least 2, as"),
    # New code that nothing runs.
    Edit("render", "harness/nets/lobes.py", "_START = -1.0\n",
         "_START = -1.0\n\n\ndef widest(raw: Tensor) -> Tensor:\n"
         '    """Of all lobes."""\n    return 2 * log_sigma(raw).amax(-1)\n'),
    Edit("render", "harness/rendering/passes.py", "LANES = 1 << 18\n",
         "FEW = 1 << 4\nLANES = 1 << 18\n"),
    Edit("render", "harness/core/protocol/material.py", "    def peaks(self, condition: Tensor)",
         "    def grey(self, condition: Tensor, wo: Tensor) -> Tensor:\n"
         '        """Mean of the channels."""\n        return self.eval(condition, wo).mean(1)\n\n'
         "    def peaks(self, condition: Tensor)"),
    Edit("render", "harness/core/protocol/method.py", "    def size_bytes(self) -> int:",
         "    def count_tensors(self) -> int:\n"
         '        """Of the state."""\n        return len(self.state_dict())\n\n'
         "    def size_bytes(self) -> int:"),
    Edit("render", "harness/scenes/library.py", 'SCENES: dict[str, Callable[..., Scene]] = {\n',
         "def grey_sphere() -> Scene:\n"
         '    """A sphere under a dim sky."""\n    return uniform_sphere(radiance=0.5)\n\n\n'
         'SCENES: dict[str, Callable[..., Scene]] = {\n    "grey-sphere": grey_sphere,\n'),
    Edit("render", "harness/effects/transport.py", "class Media(Effect):\n",
         'class Polarised(Effect):\n    """Polarised light."""\n\n    name = "polarised"\n\n'
         "    def add(self, recipe: Recipe) -> Recipe:\n"
         '        """See :meth:`Effect.add`."""\n        return replace(recipe, channels=12)\n\n\n'
         "class Media(Effect):\n"),
    # Imports.
    Edit("render", "harness/rendering/passes.py",
         "from harness.stats.moments import one_sample_variance\n",
         "from harness.stats.moments import one_sample_variance as one_sample_variance\n"
         "import math\n"),
    Edit("pdf", "harness/measures/pdf.py", "from harness.stats import divergence\n",
         "import harness.stats.divergence as divergence\n"),
    # Order and place.
    Edit("render", "harness/textures/maps.py", _OLD_UNIT_RANGE, "",
         ("harness/textures/maps.py", UNIT_RANGE)),
    Edit("render", "harness/textures/maps.py", _OLD_UNIT_RANGE,
         "from harness.textures.noise import unit_range\n",
         ("harness/textures/noise.py", UNIT_RANGE)),
    Edit("neural", "harness/materials/neural/material.py", _OLD_COSINE,
         "from harness.materials.neural.column_lookup import _cosine\n",
         ("harness/materials/neural/column_lookup.py", COSINE)),
)  # fmt: skip
"""Edits that the digests do not see."""

PROBED = (
    Edit("render", "harness/nets/lobes.py",
         "    scale = dr.rcp(total)\n    return [value * scale for value in exps]",
         "    return _scaled(exps, dr.rcp(total))\n\n\n"
         "def _scaled(values: Columns, scale: Float) -> Columns:\n"
         "    return [value * scale for value in values]"),
    Edit("render", "harness/nets/lobes.py", "    return _RANGE * dr.tanh(raw * (1 / _RANGE))",
         "    bounded = dr.tanh(raw * (1 / _RANGE))\n    return bounded * _RANGE"),
    Edit("neural", "harness/materials/neural/material.py",
         "        inside = x * x + y * y < 1\n        if a.output",
         "        inside = dr.fma(x, x, y * y) < 1\n        if a.output"),
    Edit("render", "harness/materials/mitsuba_bsdf.py",
         "        # Mitsuba includes the cosine; off the hemisphere there is nothing to divide.\n"
         "        return dr.select(inside, value / cos, 0)",
         "        return dr.select(inside, value * dr.rcp(cos), 0)"),
    Edit("walks", "harness/materials/families/ggx.py",
         "    return 0.5 * t / (w.z * (dr.sqrt(w.z * w.z + t) + w.z))",
         "    longer = dr.sqrt(t + w.z * w.z) + w.z\n    return 0.5 * t / (longer * w.z)"),
    Edit("pdf", "harness/core/protocol/disk.py", "    return rgb @ torch.tensor(REC709,",
         "    weights = REC709\n    return rgb @ torch.tensor(weights,"),
)  # fmt: skip
"""Edits that change code and no number: here a probe decides."""
