"""The integral under constant light: cells, common points, known answers, and coverage."""

from __future__ import annotations

import functools
import gc
import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.constant_light import preferred
from harness.analysis.integral import variance_of
from harness.analysis.pooling import Pooled, variance_ratio
from harness.analysis.records.constant_light import numbers
from harness.core import registry
from harness.core.protocol.disk import square_to_disk
from harness.core.record import Raw
from harness.core.streams import generator
from harness.measures import light_cells as cells
from harness.mitsuba_runtime import variant
from harness.stats.log_interval import LogInterval
from harness.stats.variance import Deviations, Variance, diagnosed
from harness.store.stored import Stored
from tests.fakes import FakeMaterial
from tests.measure_subjects import SCENE, Uneven, job, measured

variant.use("cpu")

# A Mitsuba class belongs to a variant.
from harness.measures.constant_light import _some, integrated  # noqa: E402
from harness.measures.light_points import draw  # noqa: E402
from harness.rendering import seen  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def _no_bsdf_stays() -> Iterator[None]:
    """Scenes of methods in PyTorch end here: Mitsuba traces every BSDF alive in others' renders."""
    yield
    prepared_at.cache_clear()
    gc.collect()


class Texel(FakeMaterial):
    """Lambertian and black but for squares of the texture, one in 36, of albedo ``bright``."""

    n_features = 1

    def __init__(self, name: str, bright: float = 6.0, dark: float = 0.1):
        super().__init__(name)
        self.bright, self.dark = bright, dark

    def places(self, uv: Tensor) -> Tensor:
        """See :meth:`Material.places`."""
        lit = ((uv * 12) % 6 < 1).all(-1, keepdim=True)
        return torch.where(lit, self.bright, self.dark)

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        return super().eval(condition, wo) * condition[:, :1]


@functools.cache
def prepared_at(resolution: int) -> tuple:
    """Of the bright texels: the render, and the pixels of its mask."""
    one = job("constant-light", Uneven(), Texel("texel"))
    ready = prepare(SCENE, one.material, one.method, resolution)
    return ready, np.argwhere(ready.mask)


# --- cells ---------------------------------------------------------------------------------------


def test_leaves_divide_the_disk() -> None:
    """Their areas add up to the disk's, and a point of a leaf lies in that leaf."""
    score = torch.rand(5, cells.CELLS, generator=generator(1))
    leaves = cells.Leaves.of(score)
    area = cells.areas(score.device)
    assert torch.allclose(torch.where(leaves.used, area, 0).sum(1), torch.tensor(math.pi))
    assert (leaves.used.sum(1) == cells.USED).all()
    row, leaf = leaves.used.nonzero(as_tuple=True)
    u = 0.01 + 0.98 * torch.rand(len(row), 2, generator=generator(2))
    assert torch.equal(leaves.at(row, leaves.points(row, leaf, u)), leaf)
    # Whichever leaf a point is in, it is in that cell.
    wo = square_to_disk(torch.rand(len(row), 2, generator=generator(3)))
    found = leaves.at(row, wo)
    assert leaves.used[row, found].all()
    divided = found >= cells.CELLS
    owner = torch.where(
        divided, leaves.divided[row, (found - cells.CELLS).clamp(min=0) // cells.PARTS], found
    )
    assert torch.equal(owner, cells.cell_of(wo))


def test_picks_are_as_many_as_the_rates_say() -> None:
    rate = torch.tensor([[0.0, 2.5, 0.25], [0.0, 4.0, 0.6]])
    picks = [cells.stratified(rate, generator(k)) for k in range(400)]
    counts = torch.stack([torch.bincount(one, minlength=6) for one in picks]).double()
    off = counts.mean(0) - rate.flatten()
    assert off.abs().max() < 0.1
    assert ((counts - rate.flatten()).abs() < 2).all() and not counts[:, [0, 3]].any()
    assert not len(cells.stratified(torch.zeros(2, 3), generator(0)))


def test_the_common_directions_integrate_anything() -> None:
    """One over their rates is a quadrature of the disk at every pixel."""
    ready, pixels = prepared_at(12)
    material = Texel("texel")
    found = draw(ready, material, pixels, 400 * len(pixels), 7)
    x = found.wo[:, 0]
    for h, expected in ((torch.ones_like(x), math.pi), (x.square(), math.pi / 4)):
        weight = (h / found.rate * found.share[found.row]).sum() / found.pixels
        assert float(weight) == pytest.approx(expected, rel=0.03)
    direct = (found.f / found.rate * found.share[found.row]).sum()
    mean = (found.albedo.mean(0) * found.share).sum()
    assert float(direct) == pytest.approx(float(mean), rel=0.02)


# --- known answers -------------------------------------------------------------------------------


def texel_variance(resolution: int, chi: float) -> float:
    """Variance of a sampler of chi-square ``chi`` at every point: of 128 points a pixel."""
    ready, pixels = prepared_at(resolution)
    rng, square, mean = np.random.default_rng(3), 0.0, 0.0
    per = 128
    for k in range(per):
        within = rng.random((len(pixels), 2))
        condition = seen.conditions(ready, pixels, within, k)
        albedo = condition[:, 0].double().numpy()
        square, mean = square + albedo**2 / per, mean + albedo / per
    # Of the square of a mean of so many, which has a part of their variance.
    squared = mean**2 - (square - mean**2) / (per - 1)
    return float(((1 + chi) * square - squared).mean())


def test_a_few_bright_texels_are_resolved() -> None:
    """They carry nearly all of the variance; the answer is of 128 points of every pixel."""
    share = 0.5
    found = variance_of(
        measured("constant-light", Uneven(share), Texel("texel"), resolution=20).arrays
    )
    exact = texel_variance(20, (1 / share + 1 / (2 - share)) / 2 - 1)
    assert found.total.tail in ("light", "heavy")
    low, high = found.total.log.interval[1:]
    # Its interval, half as wide again, and what 128 points leave open.
    spread = math.log(high / low) / 2
    assert abs(math.log(found.total.value / exact)) < 1.5 * spread + 0.04
    assert found.total.log.factor < 2


def test_fewer_pixels_than_there_are() -> None:
    """Each half has others of them, so that the interval knows how pixels differ."""
    pixels = np.arange(100).reshape(50, 2)
    one, other = (_some(pixels, 10, np.random.default_rng(k)) for k in range(2))
    assert len(one) == 10 and not np.array_equal(one, other)
    assert (np.searchsorted(pixels[:, 0], one[:, 0]) // 5 == np.arange(10)).all()
    assert _some(pixels, 50, np.random.default_rng(0)) is pixels
    few = variance_of(
        measured("constant-light", Uneven(0.5), Texel("texel"), resolution=20, pixels=40).arrays
    )
    all_of_them = variance_of(
        measured("constant-light", Uneven(0.5), Texel("texel"), resolution=20).arrays
    )
    assert few.total.log.factor > all_of_them.total.log.factor


def test_the_order_of_methods_changes_nothing() -> None:
    """Points are made once for a material; whoever comes first, the numbers are the same."""
    grey = FakeMaterial("grey")
    first = measured("constant-light", Uneven(0.5), grey, resolution=12)
    measured("constant-light", registry.make("cosine"), grey, resolution=12)
    again = measured("constant-light", Uneven(0.5), grey, resolution=12)
    fresh = measured("constant-light", Uneven(0.5), FakeMaterial("grey"), resolution=12)
    for name, array in first.arrays.items():
        assert np.array_equal(array, again.arrays[name])
        assert np.array_equal(array, fresh.arrays[name])


def repeated(repeats: int) -> float:
    """Share of intervals that hold the closed form, over measurements of other seeds."""
    share, grey, held = 0.4, FakeMaterial("grey"), 0
    exact = (1 / share + 1 / (2 - share)) / 2 - 1
    one = job("constant-light", Uneven(share), grey)
    one.method.bind(grey)
    ready = prepare(SCENE, grey, one.method, 10)
    pixels = np.argwhere(ready.mask)
    for k in range(repeats):
        halves = [draw(ready, grey, pixels, 16 * len(pixels), 2 * k + b) for b in range(2)]
        found = variance_of(integrated(one.method, halves, 16, k) | {"radiance": np.array(1.0)})
        low, high = found.total.log.interval[1:]
        held += low <= exact <= high
    return held / repeats


def test_intervals_hold_the_closed_form() -> None:
    """Of 16, at least 12: fewer have a chance below 1 in 1000 at 95 %."""
    assert repeated(16) >= 12 / 16


@pytest.mark.slow
def test_coverage_is_95_percent() -> None:
    assert 0.93 - 0.022 <= repeated(400) <= 0.97 + 0.017


# --- what takes its place ------------------------------------------------------------------------


def _stored(arrays: dict) -> Stored:
    return Stored("key", {}, {}, "ok", "", reader=lambda *_: arrays)


def _rendered(value: float, width: float) -> Pooled:
    log = LogInterval(math.log(value), width, width)
    return Pooled(Variance(value, log, "light", 0.0), 48.0)


def test_a_resolved_integral_is_taken_and_contradictions_are_said() -> None:
    arrays = measured("constant-light", Uneven(0.5), FakeMaterial("grey"), resolution=12).arrays
    value = variance_of(arrays).total.value
    same = preferred(_stored(arrays), _rendered(value, 1e-6))
    assert same.exact and not same.doubt
    apart = preferred(_stored(arrays), _rendered(3 * value, 0.1))
    assert apart.exact and "renders" in apart.doubt
    ratio = variance_ratio(same, apart)
    assert "renders contradict its variance" in ratio.note
    # What is not resolved gives way to the renders.
    y = np.random.default_rng(0).standard_normal((2, 400))
    y[0, 0] = 1e6
    lost = {**arrays, "deviations": Deviations.of(y).packed()}
    assert diagnosed(1.0, Deviations.of(y)).tail == "not resolved"
    other = _rendered(value, 0.1)
    assert preferred(_stored(lost), other) is other
    assert preferred(None, other) is other


def test_a_share_is_one_of_a_variance_that_is_resolved() -> None:
    arrays = measured("constant-light", Uneven(0.5), FakeMaterial("grey"), resolution=12).arrays
    y = np.random.default_rng(0).standard_normal((2, 400))
    y[0, 0] = 1e6
    for deviations, known in ((arrays["deviations"], True), (Deviations.of(y).packed(), False)):
        found = numbers(Raw({**arrays, "deviations": deviations})).records
        by_name = {record.metric: record for record in found}
        assert ("footprint-share" in by_name) == known
        assert by_name["tail-resolved"].value == known and "footprint-variance" in by_name


def test_an_older_store_of_points_is_read() -> None:
    rng = np.random.default_rng(5)
    sampler = rng.gamma(4.0, 0.25, (2, 300))
    albedo = np.full((2, 2, 300), 0.5)
    old = {"sampler": sampler, "albedo": albedo, "radiance": np.array(2.0)}
    found = variance_of(old)
    assert found.total.value == pytest.approx(4 * sampler.mean())
    assert found.footprint.value == 0 and found.power == pytest.approx(1.0)
