"""The same samples seen through Mitsuba: its own chi-square test on the renderer's plugin.

``mi.chi2.BSDFAdapter`` weighs samples by ``value != 0`` and so rejects a correct sampler where
the BSDF itself is black. Here a sample counts where its density is not zero, which is what
``pdf`` is compared with.
"""

from __future__ import annotations

import math
import zlib
from typing import Any

import torch

from harness.checks.finding import Finding, held
from harness.checks.subject import COSINES
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.mitsuba_runtime import variant

SAMPLES = 500_000
RESOLUTION = 64
SUBDIVISIONS = 32
"""Points per cell and axis of Mitsuba's integration, which knows no refinement."""


def mitsuba_chi2(
    method: Method,
    material: Material,
    seed: int = 0,
    *,
    device: str = "cpu",
    alpha: float = 5e-4,
    samples: int = SAMPLES,
) -> list[Finding]:
    """Mitsuba's ``ChiSquareTest`` of a *fitted* ``method``, one finding per inclination of wi.

    ``alpha`` is the level of all together. Mitsuba's cells are a fixed grid, 64 x 64 on the
    hemisphere: lobes and steps much finer than 0.1 degrees are beyond its integration.
    """
    mi = variant.use(device)
    from harness.rendering.plugin import SampledBSDF

    bsdf = SampledBSDF(material, method)
    random = torch.Generator().manual_seed(seed + zlib.crc32(material.name.encode()))
    findings = []
    for name, cosine in COSINES.items():
        azimuth, u, v = torch.rand(3, generator=random).tolist()
        sine, turn = math.sqrt(1 - cosine**2), 2 * math.pi * azimuth
        place = ((sine * math.cos(turn), sine * math.sin(turn), cosine), (u, v))
        stream = int(torch.randint(1 << 31, (), generator=random))
        test = _test(mi, bsdf, place, stream, samples)
        ok = bool(test.run(alpha, test_count=len(COSINES), quiet=True))
        messages = " ".join(test.messages.split())
        text = messages if test.p_value is None or test.fail else f"p = {test.p_value:.2g}"
        worst = {} if ok else {"wi": place[0], "uv": place[1]}
        findings.append(Finding("mitsuba-chi2", name, held(ok), text, worst))
    return findings


def _test(mi: Any, bsdf: Any, place: tuple, seed: int, samples: int) -> Any:
    import drjit as dr
    import mitsuba.chi2

    context = mi.BSDFContext()

    def interaction(n: int) -> Any:
        si = dr.zeros(mi.SurfaceInteraction3f, n)
        si.wi, si.uv = mi.Vector3f(*place[0]), mi.Point2f(*place[1])
        si.n = mi.Normal3f(0, 0, 1)
        si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
        # Normal and bump maps build their frame from these.
        si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        return si

    def sample(u: Any) -> Any:
        drawn, _ = bsdf.sample(context, interaction(dr.width(u)), u.x, mi.Point2f(u.y, u.z))
        counted = drawn.pdf > 0
        # A sample that does not count needs a place on the domain all the same.
        wo = dr.select(counted, drawn.wo, mi.Vector3f(0, 0, 1))
        return wo, dr.select(counted, mi.Float(1), 0)

    def density(wo: Any) -> Any:
        return bsdf.pdf(context, interaction(dr.width(wo)), wo) * (2 * math.pi)

    class Hemisphere:
        """The unit square, mapped to the hemisphere with equal areas."""

        def bounds(self) -> Any:
            return mi.ScalarBoundingBox2f([0, 0], [1, 1])

        def aspect(self) -> float:
            return 1.0

        def map_forward(self, p: Any) -> Any:
            return mi.warp.square_to_uniform_hemisphere(p)

        def map_backward(self, wo: Any) -> Any:
            return mi.warp.uniform_hemisphere_to_square(wo)

    return mitsuba.chi2.ChiSquareTest(
        domain=Hemisphere(),
        sample_func=sample,
        pdf_func=density,
        sample_dim=3,
        sample_count=samples,
        res=RESOLUTION,
        ires=SUBDIVISIONS,
        seed=seed,
    )
