"""Rays against beds of primitives, and where the primitives stand."""

from __future__ import annotations

import numpy as np
import pytest

from harness.core.protocol.errors import InputError
from harness.microgeometry.walks import beckmann, placing
from harness.microgeometry.walks.description import parse
from harness.microgeometry.walks.primitives import Primitives, turned
from harness.mitsuba_runtime import variant

mi = variant.use("cpu")

from harness.microgeometry.walks.bed import Bed  # noqa: E402
from harness.microgeometry.walks.micro import MicroBSDF  # noqa: E402


def bed_of(shape: str, per_side: int, seed: int) -> tuple[Primitives, Bed]:
    """Primitives of all sizes and turns that may overlap, and their bed."""
    random = np.random.default_rng(seed)
    n = per_side**2
    half = random.uniform(0.1, 0.45, (n, 3)) / per_side
    if shape == "pyramid":
        half[:, 1] = half[:, 0]
    tilt = random.uniform(-0.5, 0.5, n) * (shape != "pyramid")
    axes = turned(random.uniform(0, 3, n), tilt) * half[:, None]
    z = np.zeros(n) if shape == "pyramid" else random.uniform(-0.5, 1, n) * half.min(1)
    found = Primitives(
        shape, np.concatenate([random.random((n, 2)), z[:, None]], 1), axes, np.ones((n, 3))
    )
    micro = MicroBSDF.of("mirror", "micro")
    return found, Bed(mi, found, micro, micro, found.mean_height)


def first_hit(found: Primitives, origin: np.ndarray, d: np.ndarray, reach: int) -> np.ndarray:
    """Distances [N] along rays to the first primitive or the ground, by all copies one by one."""
    best = np.where(d[:, 2] < 0, -origin[:, 2] / d[:, 2], np.inf)
    inverse = np.linalg.inv(found.axes)
    for dx in range(-reach, reach + 1):
        for dy in range(-reach, reach + 1):
            for centre, m in zip(found.centre, inverse, strict=True):
                p, v = (origin - centre - [dx, dy, 0]) @ m.T, d @ m.T
                best = np.minimum(best, meet(found.shape, p, v))
    return best


def meet(shape: str, p: np.ndarray, v: np.ndarray) -> np.ndarray:
    if shape == "sphere":
        a, b, c = (v * v).sum(1), (p * v).sum(1), (p * p).sum(1) - 1
        root = b * b - a * c
        t = (-b - np.sqrt(np.maximum(root, 0))) / a
        return np.where((root > 0) & (t > 0), t, np.inf)
    t = np.full(len(p), np.inf)
    planes = np.array([[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]], float)
    for plane in planes:
        at = (1 - p @ plane) / (v @ plane)
        q = p + at[:, None] * v
        on = (np.abs(q[:, 0]) + q[:, 2] < 1 + 1e-9) & (np.abs(q[:, 1]) + q[:, 2] < 1 + 1e-9)
        t = np.where(on & (q[:, 2] >= 0) & (at > 0) & (v @ plane < 0), np.minimum(t, at), t)
    return t


@pytest.mark.parametrize(
    ("shape", "per_side"), [("sphere", 1), ("sphere", 5), ("pyramid", 1), ("pyramid", 4)]
)
def test_the_first_hit_is_that_of_all_copies_one_by_one(shape, per_side):
    found, bed = bed_of(shape, per_side, 3)
    random = np.random.default_rng(0)
    n, g = 4000, bed.cells
    origin = np.concatenate([random.random((n, 2)), np.full((n, 1), found.top)], 1)
    d = random.standard_normal((n, 3))
    # So flat that rays go through some tiles, not so flat that they leave the copies.
    d[:, 2] = -np.abs(d[:, 2]) - 0.3
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    expected = first_hit(found, origin, d, 3)
    hit = bed.hit(
        mi.Point3f((origin * g).T.astype(np.float32)),
        mi.Vector3f(d.T.astype(np.float32)),
        mi.Mask(True),
    )
    assert np.array(hit.valid).all() and not np.array(hit.given_up).any()
    t = np.array(hit.si.t) / g
    far = np.abs(t - expected) > 1e-4
    # Rays that graze an edge are met in one precision and missed in the other.
    assert far.mean() < 2e-3, (far.mean(), np.abs(t - expected).max())
    n_hit = np.array(hit.si.n).T
    np.testing.assert_allclose(np.linalg.norm(n_hit, axis=1), 1, rtol=1e-4)
    assert ((n_hit * d).sum(1) < 1e-3).mean() > 0.999


def test_arrangements():
    metric = np.eye(2) / 0.1
    points = placing.poisson(30, metric, np.random.default_rng(1))
    assert points.shape == (30, 2) and placing.closest(points, metric) >= 1
    shifted = (points + [0.37, 0.81]) % 1
    assert placing.closest(shifted, metric) == pytest.approx(placing.closest(points, metric))
    assert placing.closest(placing.grid(5), np.eye(2)) == pytest.approx(0.2)
    assert placing.closest(placing.staggered(4), np.eye(2)) == pytest.approx(0.25)
    # The closest copy of one point alone is its own, a tile away.
    assert placing.closest(np.zeros((1, 2)), np.eye(2)) == pytest.approx(1)
    with pytest.raises(InputError, match="of 100 primitives find a place"):
        placing.poisson(100, metric, np.random.default_rng(1))


@pytest.mark.parametrize(("shape", "seed"), [("sphere", 1), ("pyramid", 2)])
def test_heights_are_where_vertical_rays_end(shape, seed):
    found, bed = bed_of(shape, 4, seed)
    size, g = 64, bed.cells
    heights = found.heights(size)
    y, x = np.meshgrid(*[(np.arange(size) + 0.5) / size] * 2, indexing="ij")
    origin = np.stack([x.ravel(), y.ravel(), np.full(size * size, found.top)]) * g
    hit = bed.hit(mi.Point3f(origin.astype(np.float32)), mi.Vector3f(0, 0, -1), mi.Mask(True))
    assert np.abs(np.array(hit.si.p).T[:, 2] / g - heights.ravel()).max() < 1e-4


@pytest.mark.parametrize("alpha", [(0.2, 0.2), (0.1, 0.3)])
def test_slopes_of_a_facet_field_are_gaussian(alpha):
    """Of the deviation alpha / sqrt 2, with the kurtosis of a Gaussian."""
    height = beckmann.heights(*alpha, 512, 4, 5)
    for axis, a in ((1, alpha[0]), (0, alpha[1])):
        slope = (np.roll(height, -1, axis) - height) * 512
        assert slope.std() == pytest.approx(a / np.sqrt(2), rel=0.04)
        assert ((slope / slope.std()) ** 4).mean() == pytest.approx(3, rel=0.08)
    assert abs(height.mean()) < 1e-12 + 0.1 * height.std()


GRAINS = {
    "name": "mine",
    "about": "x",
    "primitives": {"shape": "sphere", "per_side": 4, "size": 0.4},
    "micro": "mirror",
}


def changed(**change) -> dict:
    primitives = {**GRAINS["primitives"], **change.pop("primitives", {})}
    return {**GRAINS, "primitives": primitives, **change}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (changed(primitives={"shape": "spere"}), "shape.*spere"),
        (changed(primitives={"sise": 1}), "sise.*size"),
        (changed(primitives={"size": [0.1, 0.2]}), "size: expected 1 numbers for 'sphere', got 2"),
        (changed(primitives={"arrangement": "grid", "size": 0.7}), "each other by 29%.*of 0%"),
        (changed(primitives={"size": 0.5}), "of 16 primitives find a place"),
        (
            changed(primitives={"per_side": 1, "size": 0.6, "overlap": 0.5}),
            "1.20 tiles wide; expected at most one",
        ),
        (changed(primitives={"arrangement": "staggered", "per_side": 3}), "even number"),
        (changed(micro="miror"), "miror.*mirror"),
        (changed(micro={"bsdf": {"reflectance": 1}}), "with its 'type'"),
        (changed(facets={"alpha": 0.2}), "either 'primitives' or 'facets'"),
        ({k: v for k, v in GRAINS.items() if k != "primitives"}, "either 'primitives' or 'facets'"),
    ],
)
def test_what_is_refused_in_one_line(data, message):
    with pytest.raises(InputError, match=message) as refused:
        parse(data)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("micro", "message"),
    [
        ({"bsdf": {"type": "nothing-such"}}, "Mitsuba refuses the BSDF"),
        ({"bsdf": {"type": "dielectric"}}, "'dielectric' transmits"),
        ({"bsdf": {"type": "constant"}}, "expected a BSDF"),
        ({"bsdf": "lambertian", "reflectance": "#000000"}, "absorbs every particle"),
        ({"bsdf": {"type": "diffuse", "reflectance": 0.0}}, "absorbs every particle"),
        ({"bsdf": {"type": "null"}}, "transmits"),
    ],
)
def test_micro_bsdfs_that_are_refused(micro, message):
    surface = parse(changed(micro=micro))
    with pytest.raises(InputError, match=message) as refused:
        surface.geometry("cpu")
    assert "\n" not in str(refused.value) and "mine" in str(refused.value)


def test_a_bsdf_that_cannot_sample_is_refused():
    class NoSampler(mi.BSDF):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def to_string(self):
            return "NoSampler"

    mi.register_bsdf("no_sampler", NoSampler)
    surface = parse(changed(micro={"bsdf": {"type": "no_sampler"}}))
    with pytest.raises(InputError, match="'no_sampler' cannot sample itself"):
        surface.geometry("cpu")
