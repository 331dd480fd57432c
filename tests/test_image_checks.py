"""Methods as a renderer uses them: white furnace, mean images, MIS on, off and misled."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.analysis.records import image_checks as records
from harness.analysis.records.image_checks import ROUNDING
from harness.core import registry
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.measures.base import Job
from harness.mitsuba_runtime import variant
from harness.report.tables.image_checks import CHECKS, RATIOS
from harness.scenes import registry as scenes
from harness.stats.blocks import Blocks
from harness.stats.intervals import mean_interval
from harness.stats.ztest import Agreement
from tests import measuring
from tests.test_rendering import SometimesNan, UniformDisk, White, mitsuba, white, xml_scene

mi = variant.use("cpu")

from harness.measures.image_checks import FURNACE, is_white  # noqa: E402
from harness.rendering.misreported import MisreportedBSDF, tilted, tripled  # noqa: E402
from harness.rendering.prepared import Prepared, prepare  # noqa: E402

BUDGET = Budget(steps=120, conditions=64, directions=32, resolution=32, pool=256)
"""As ``harness check`` fits."""
ALPHA = 1e-3
"""Chance that a right method fails a test of this file; seeds are fixed, so it happens or not."""
STUDIO = scenes.make("studio-sphere")


# --- planted faults --------------------------------------------------------------------


class Tilted(Method):
    """Right, and not the cosine: the density (1 + x / 2) / pi on the disk.

    A point uniform on the disk has its x made positive with probability 1/2 + |x| / 4, else
    negative, which is x's share of the density at x and -x.
    """

    name = "leaning"
    factor = 1.0
    """Of the density it reports, sampled and asked for."""
    limit = math.inf
    """Samples of a larger f / p are dropped."""

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        turn = 2 * math.pi * u[:, 1]
        x, y = (u[:, :1].sqrt() * torch.stack([turn.cos(), turn.sin()], -1)).unbind(-1)
        right = u[:, 2] < 0.5 + x.abs() / 4
        wo = torch.stack([torch.where(right, x.abs(), -x.abs()), y], -1)
        pdf = self.pdf(condition, wo)
        large = 1 / math.pi / pdf > self.limit
        return DiskSample(torch.where(large[:, None], 2.0, wo), pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(inside_disk(wo), self.factor * (1 + wo[:, 0] / 2) / math.pi, 0)


class FivePercent(Tilted):
    """Its weights are five per cent too large."""

    name = "five-percent"
    factor = 1 / 1.05


class DropsLarge(Tilted):
    """Without the largest weights: at x < -0.9 on the disk."""

    name = "drops-large"
    limit = 1 / (1 - 0.45)


class Tripled(Tilted):
    """A density three times too large, in the value too."""

    name = "tripled"
    factor = 3.0


class OtherDensity(Tilted):
    """Its ``pdf`` is not the density of its samples, whose own is right."""

    name = "other-density"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo = super().sample(condition, u).wo
        return DiskSample(wo, Tilted.pdf(self, condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return super().pdf(condition, wo) * (1 + 0.5 * wo[:, 1])


class Hole(Tilted):
    """Never to the side x < -0.5, without saying so in the weights of the rest."""

    name = "hole"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, pdf = super().sample(condition, u)
        return DiskSample(torch.where(wo[:, :1] < -0.5, 2.0, wo), pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(wo[:, 0] < -0.5, 0, super().pdf(condition, wo))


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


# --- helpers ---------------------------------------------------------------------------


def grey() -> Material:
    """Lambertian, and not white."""
    return mitsuba("diffuse", reflectance={"type": "rgb", "value": 0.4})


def fitted(method: str | Method, material: Material) -> Method:
    """Shortly; tables get a size for tests."""
    if isinstance(method, str):
        small = {"resolution": 16} if method == "tabulated" else {}
        method = registry.make(method, **small)
    method.fit(material, BUDGET, torch.Generator().manual_seed(0))
    return method


def job(method: Method, material: Material, scene: Any = STUDIO, **given: Any) -> Job:
    """As the runner makes it."""
    return Job(
        trial=None,
        material=material,
        method=method,
        scene=scene,
        seed=0,
        generator=torch.Generator().manual_seed(0),
        settings=measures.settings("image-checks", given),
        budget=BUDGET,
        make=lambda: type(method)(),
    )


def run(method: str | Method, material: Material, scene: Any = STUDIO, **given: Any):
    """Records of the measure, by metric, at a size for tests."""
    given = {"batches": 6, "spp": 16, "resolution": 24, "reference_spp": 512, **given}
    method = fitted(method, material)
    outcome = measuring.run("image-checks", [job(method, material, scene, **given)])[0]
    assert outcome.status == "ok"
    found = {r.metric: r for r in outcome.records}
    assert len(found) == len(outcome.records)
    return found


@dataclass(frozen=True)
class Image:
    """Mean luminance [H, W] and the variance of that mean."""

    mean: NDArray
    variance: NDArray


def compare(image: Image, expected: Image, mask: NDArray[np.bool_]) -> Agreement:
    """As the records are made, of moments of blocks."""
    blocks = (Blocks.of(one.mean, one.variance, mask) for one in (image, expected))
    return records.compare(*blocks)


def image(prepared: Prepared, spp: int, seed: int, batches: int = 6) -> Image:
    """Of ``batches`` renders of ``spp`` samples each; the variance from their scatter."""
    means = np.array([prepared.render(spp, seed + k).mean for k in range(batches)])
    return Image(means.mean(0), means.var(0, ddof=1) / batches)


def furnace_p(method: Method, material: Material, spp: int = 32) -> float:
    """p-value of one being the mean of the white furnace."""
    prepared = prepare(FURNACE, material, method, 24)
    assert prepared.mask.all()
    seen = image(prepared, spp, 100)
    ones = np.ones_like(seen.mean)
    return compare(seen, Image(ones, 0 * ones), prepared.mask).p_value


# --- the furnace -----------------------------------------------------------------------


SAMPLERS = [name for name in registry.names() if registry.load(name).exact_pdf]
"""Of any material. A random walk knows its own families alone, see test_random_walk; the
published importance baking is biased and says so."""


@pytest.mark.parametrize("name", SAMPLERS)
def test_white_furnace(name):
    """All methods: a surface that reflects all light is as bright as the light."""
    material = white()
    method = fitted(name, material)
    assert method.supports(material)[0]
    assert furnace_p(method, material, spp=4 if name in ("histogram", "tabulated") else 32) > ALPHA


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize("material", ["suede", "brushed-metal"])
def test_furnace_of_materials(name, material):
    """All methods: constant light shows the albedo, and all other checks pass, too."""
    found = run(name, materials.make(material), resolution=32, spp=64, reference_spp=2048)
    assert found["p"].value > ALPHA
    assert found["furnace"].ci_low - 0.05 < 0 < found["furnace"].ci_high + 0.05


@pytest.mark.parametrize("make", [white, White], ids=["mitsuba", "torch"])
@pytest.mark.parametrize("method", [FivePercent, DropsLarge, Tripled, Hole])
def test_furnace_catches(make, method):
    """Weights that are wrong by five per cent, large ones that are dropped, a pdf that is not."""
    material = make()
    assert furnace_p(fitted(Tilted(), material), material) > ALPHA
    assert furnace_p(fitted(method(), material), material) < 1e-12


def test_rounding_is_no_bias():
    """An image without noise agrees up to single precision's rounding, and no further."""
    rng = np.random.default_rng(0)
    ones = np.ones((32, 32))
    everywhere, expected = np.ones((32, 32), bool), Image(ones, 0 * ones)
    jitter = 1 + 2.0**-22 * rng.integers(-4, 5, ones.shape)
    for mean in (ones, (1 - ROUNDING / 4) * ones, jitter):
        assert compare(Image(mean, 0 * ones), expected, everywhere).p_value > 0.3
    for bias in (1e-4, -1e-4):
        assert compare(Image(ones + bias, 0 * ones), expected, everywhere).p_value < 1e-6
    # With noise, that decides: the same bias far below it is no news.
    noise = Image(ones + 1e-4 + 0.01 * rng.standard_normal(ones.shape), 1e-4 * ones)
    assert compare(noise, expected, everywhere).p_value > ALPHA


def test_furnace_loses_no_light():
    """A cosine sample of a white Lambertian has the weight one: a pixel has no other value."""
    material = white()
    done = prepare(FURNACE, material, fitted("cosine", material), 24).render(1024, 1)
    lost = 1 - done.mean
    # A ray in a million falls through an edge between facets.
    assert (np.abs(lost) > 1e-5).sum() <= 8 and lost.mean() < 8 / (1024 * 24 * 24)


def test_is_white():
    """Albedo one, the same for all directions."""
    own = torch.Generator().manual_seed(0)
    assert is_white(white(), own) and is_white(White(), own)
    assert not is_white(grey(), own) and not is_white(White(0.999), own)
    assert not is_white(materials.make("suede"), own)


# --- MIS -------------------------------------------------------------------------------


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


# --- the measure -----------------------------------------------------------------------


def test_measure():
    """All checks of a right method, with intervals; its numbers fit together."""
    found = run("cosine", grey())
    assert set(found) == {
        *(f"{c}{end}" for c in CHECKS for end in ("", "-z", "-p")),
        *RATIOS,
        "p",
        "spp",
    }
    assert found["p"].value > ALPHA
    assert found["p"].value <= 6 * min(found[f"{c}-p"].value for c in CHECKS)
    for name in (*CHECKS, *RATIOS):
        record = found[name]
        assert record.ci_low < record.value < record.ci_high and record.unit == "1"
    assert found["mis-variance"].ci_high < 1 < found["tripled-variance"].ci_low
    assert found["spp"].value == 96


def test_measure_of_an_exact_sampler():
    """Furnace without noise; in constant light MIS only adds some."""
    found = run("cosine", white(), scene=scenes.make("uniform-sphere"), reference_spp=64)
    assert abs(found["furnace"].value) < 1e-5 and found["furnace-p"].value > 0.3
    assert found["mis-variance"].value == math.inf
    assert found["tripled-variance"].ci_high < 1
    assert found["p"].value > ALPHA


@pytest.mark.parametrize(
    ("method", "guilty", "innocent"),
    [
        (FivePercent, ("furnace",), ()),
        # Its two strategies differ in the mean: weighed otherwise, they give another one.
        (Tripled, ("furnace", "reference", "mis", "tripled"), ()),
        (Hole, ("furnace", "mis"), ("mis-reference", "tripled", "tilted")),
        (OtherDensity, ("mis-reference",), ("furnace", "reference")),
    ],
)
def test_measure_catches(method, guilty, innocent):
    """Each fault by the check that is there for it, and not by one that cannot see it."""
    found = run(method(), grey(), spp=48, reference_spp=1024)
    for check in guilty:
        assert found[f"{check}-p"].value < 1e-4, check
    for check in innocent:
        assert found[f"{check}-p"].value > ALPHA, check
    assert found["p"].value < ALPHA


def test_black_material():
    """Nothing is reflected, nothing is relative to it; still no nan."""
    black = mitsuba("diffuse", reflectance={"type": "rgb", "value": 0.0})
    found = run("cosine", black)
    assert set(found) == {*(f"{c}{end}" for c in CHECKS for end in ("-z", "-p")), "p", "spp"}
    assert found["p"].value == 1
