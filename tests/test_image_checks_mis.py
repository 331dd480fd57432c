"""Image checks of multiple importance sampling."""

from __future__ import annotations

import gc
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample
from harness.materials import registry as materials
from harness.mitsuba_runtime import variant
from harness.stats.intervals import mean_interval
from tests.test_rendering import SometimesNan, UniformDisk, White, white, xml_scene

mi = variant.use("cpu")

from harness.rendering.misreported import MisreportedBSDF, tilted, tripled  # noqa: E402
from harness.rendering.prepared import Prepared, prepare  # noqa: E402
from tests.image_subjects import ALPHA, STUDIO, Image, Tilted, compare, fitted, grey, image  # noqa: E402


class NanPdf(UniformDisk):
    """Its samples are right; asked for the density of a direction it sometimes has none."""

    name = "nan-pdf"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, _ = super().sample(condition, u)
        return DiskSample(wo, torch.full_like(u[:, 0], 1 / math.pi))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(wo[:, 0].abs() < 0.01, math.nan, super().pdf(condition, wo))


# --- MIS -------------------------------------------------------------------------------


@pytest.fixture(scope="module", autouse=True)
def _none_stay():
    """A render compiles every BSDF that is alive: tests of other files are to meet none."""
    yield
    strategies.cache_clear()
    gc.collect()


@cache
def strategies(name: str) -> tuple[dict[str, Prepared], Material]:
    """BSDF samples alone, MIS, and misled MIS, of a glossy material under small bright lamps."""
    material = materials.make("brushed-metal")
    method = fitted(UniformDisk() if name == "torch" else name, material)
    made = {
        "bsdf": prepare(STUDIO, material, method, 24),
        "mis": prepare(STUDIO, material, method, 24, sampling="mis"),
    }
    for factor in (tripled, tilted, lambda wi, wo: 100.0):
        made[factor.__name__] = prepare(
            STUDIO, material, method, 24, "mis", lambda m, f, c=factor: MisreportedBSDF(m, f, c)
        )
    return made, material


@pytest.mark.parametrize("name", ["two-lobe", "histogram", "native"])
def test_mis_on_and_off_agree(name):
    """In columns and in torch, on the same image; and light samples help."""
    made, _ = strategies(name)
    mask = made["bsdf"].mask
    spp = 16 if name == "histogram" else 64
    on, off = image(made["mis"], spp, 10), image(made["bsdf"], spp, 50)
    assert compare(on, off, mask).p_value > ALPHA
    assert on.variance[mask].mean() < 0.8 * off.variance[mask].mean()
    # Nor is the test blind.
    assert compare(replace(on, mean=1.3 * on.mean), off, mask).p_value < ALPHA


def test_wrong_density_for_mis():
    """Changes the variance of one sample, by a lot, and not the mean."""
    made, _ = strategies("two-lobe")
    mask, seen, noise = made["mis"].mask, {}, {}
    for number, name in enumerate(("mis", "tripled", "tilted", "<lambda>")):
        passes = [made[name].render(64, 100 * number + k) for k in range(8)]
        means = np.array([p.mean for p in passes])
        seen[name] = Image(means.mean(0), means.var(0, ddof=1) / len(passes))
        noise[name] = mean_interval([p.error(mask) for p in passes])
    for name in ("tripled", "tilted", "<lambda>"):
        assert compare(seen[name], seen["mis"], mask).p_value > ALPHA
        assert noise[name].low > noise["mis"].high
    assert noise["<lambda>"].value > 1.5 * noise["mis"].value


def test_misreported_density():
    """The value of a sample is the right one's; every density reported has the factor."""
    material = grey()
    method = fitted(UniformDisk(), material)
    right = prepare(STUDIO, material, method, 4).bsdf
    wrong = MisreportedBSDF(material, method, tilted)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(0.3, 0.2, math.sqrt(1 - 0.13))
    context, u = mi.BSDFContext(), mi.Point2f([0.1, 0.6, 0.9], [0.7, 0.2, 0.4])
    (a, value_a), (b, value_b) = (f.sample(context, si, mi.Float(0.5), u) for f in (right, wrong))
    assert np.array_equal(value_a.numpy(), value_b.numpy())
    factor = np.exp(2 * a.wo.x.numpy())
    np.testing.assert_allclose(b.pdf.numpy(), factor * a.pdf.numpy(), rtol=1e-6)
    value, pdf = wrong.eval_pdf(context, si, a.wo)
    assert np.array_equal(value.numpy(), right.eval(context, si, a.wo).numpy())
    np.testing.assert_allclose(pdf.numpy(), b.pdf.numpy(), rtol=1e-6)
    np.testing.assert_allclose(wrong.pdf(context, si, a.wo).numpy(), b.pdf.numpy(), rtol=1e-6)


@pytest.mark.parametrize("method", [NanPdf(), SometimesNan("pdf"), SometimesNan("wo")])
def test_nan_is_not_hidden_by_mis(method):
    """A weight that is nan would count as zero; the image must not look fine."""
    material = White()
    prepared = prepare(STUDIO, material, fitted(method, material), 16, sampling="mis")
    assert not np.isfinite(prepared.render(64, 0).rgb[prepared.mask]).all()


def test_mis_in_a_file(tmp_path):
    """Of the user's, with right and misled densities; BSDF samples stay the default."""
    material = White(0.7)
    method = fitted(Tilted(), material)
    scene = xml_scene(tmp_path, "glaze")
    images = [
        image(prepared, 64, 100 * number)
        for number, prepared in enumerate(
            (
                prepare(scene, material, method, 32),
                prepare(scene, material, method, 32, "mis"),
                prepare(
                    scene, material, method, 32, "mis", lambda m, f: MisreportedBSDF(m, f, tripled)
                ),
            )
        )
    ]
    mask = prepare(scene, material, method, 32).mask
    assert mask.sum() > 10
    off, on, misled = images
    assert compare(on, off, mask).p_value > ALPHA
    assert compare(misled, on, mask).p_value > ALPHA
    assert on.mean[mask].mean() == pytest.approx(0.7, abs=0.02)


def test_unknown_sampling():
    """No strategy is taken for another."""
    with pytest.raises(KeyError):
        prepare(STUDIO, white(), fitted("cosine", white()), 4, sampling="emitter")
