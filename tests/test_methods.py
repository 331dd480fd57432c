"""Every adapter is a correct sampler: on synthetic and Mitsuba materials, fitted and not."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness.core import registry
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Method
from harness.fitting.targets import cells, tabulate
from harness.stats.chisquare import sidak
from tests.disk import compare
from tests.materials import MATERIALS

NAMES = [name for name in registry.names() if registry.load(name).exact_pdf]
"""Of the others the pdf is an approximation: see test_random_walk and test_importance_baked."""
PARAMETERS = {
    "tabulated": {"resolution": 8},
    "histogram-mixture": {"levels": 20},
    "importance-baked": {"resolution": 8, "slices": 16},
    "flow-matching": {"width": 16, "layers": 2, "steps": 4},
}
BUDGET = Budget(steps=40, conditions=64, directions=32, resolution=32, pool=256)
CASES = [("tilted", False), ("tilted", True), ("plain", True), ("mitsuba", True)]
SLOW_CASES = [("tilted", False), ("plain", True)]
SMALL = [("tilted", True), ("mitsuba", True)]
TOP = 1 - 2**-24
"""The largest uniform there is."""

each = pytest.mark.parametrize("name", NAMES)
cases = pytest.mark.parametrize(
    ("kind", "fitted"),
    [pytest.param(*case, marks=pytest.mark.slow if case in SLOW_CASES else ()) for case in CASES],
    ids=[f"{k}-{'fitted' if f else 'untrained'}" for k, f in CASES],
)
DIRECTIONS = {"steep": (0.3, -0.2), "grazing": (-0.1, 0.97)}
FOLLOWED = [("tilted", "steep"), ("mitsuba", "grazing")]
"""Each direction on one material; the other two are slow."""
followed = pytest.mark.parametrize(
    ("kind", "fitted", "wi"),
    [
        pytest.param(
            *(kind, fit, wi),
            id=f"{kind}-{'fitted' if fit else 'untrained'}-{name}",
            marks=pytest.mark.slow
            if (kind, fit) in SLOW_CASES or (kind, name) not in FOLLOWED
            else (),
        )
        for kind, fit in CASES
        for name, wi in DIRECTIONS.items()
    ],
)
small = pytest.mark.parametrize(("kind", "fitted"), SMALL, ids=[k for k, _ in SMALL])


@functools.cache
def material(kind: str) -> Material:
    """One instance of each material."""
    return MATERIALS[kind]()


def new(name: str) -> Method:
    """A fresh method, at a size for tests."""
    return registry.make(name, **PARAMETERS.get(name, {}))


@functools.cache
def _ready(name: str, kind: str, fitted: bool) -> tuple[Method, FitReport | None]:
    method = new(name)
    able, reason = method.supports(material(kind))
    if not able:
        pytest.skip(reason)
    if fitted:
        report = method.fit(material(kind), BUDGET, torch.Generator().manual_seed(0))
        return method, report
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        method.bind(material(kind))
    return method, None


def ready(name: str, kind: str, fitted: bool) -> Method:
    """The method, made once: bound only, or fitted briefly."""
    return _ready(name, kind, fitted)[0]


def rows(kind: str, n: int, seed: int = 1) -> tuple[Tensor, Tensor]:
    """Conditions [n, C] and uniforms [n, 3]."""
    generator = torch.Generator().manual_seed(seed)
    return material(kind).conditions(n, generator), torch.rand(n, 3, generator=generator)


def assert_consistent(method: Method, condition: Tensor, u: Tensor) -> None:
    """Samples are finite, and their density is the one that ``pdf`` gives."""
    wo, pdf = method.sample(condition, u)
    assert wo.shape == (len(condition), 2) and pdf.shape == (len(condition),)
    assert wo.isfinite().all() and pdf.isfinite().all()
    assert (pdf >= 0).all()
    again = method.pdf(condition, wo)
    assert again.shape == pdf.shape
    torch.testing.assert_close(again, pdf, rtol=1e-4, atol=0)


@each
@followed
def test_samples_follow_pdf(name, kind, fitted, wi):
    """Chi-square on the disk, and the pdf's integral is the share of valid samples."""
    method = ready(name, kind, fitted)
    row = rows(kind, 1)[0][0].clone()
    row[-2:] = torch.tensor(wi)
    n = 1 << 16
    test, integral, valid = compare(method, row, n, torch.Generator().manual_seed(2))
    assert abs(integral - valid) < 1e-3 + 5 * math.sqrt(valid * (1 - valid) / n)
    assert test.p_value > sidak(1e-3, 2 * len(CASES) * len(NAMES))


@each
@cases
def test_pdf_of_sample(name, kind, fitted):
    """The pdf that comes with a sample is ``pdf`` of that sample."""
    assert_consistent(ready(name, kind, fitted), *rows(kind, 4096))


@each
@small
def test_bounds_of_uniforms(name, kind, fitted):
    """Nothing breaks at the ends of [0, 1), in any combination."""
    ends = torch.tensor([0.0, 2.0**-24, 0.5, TOP])
    u = torch.cartesian_prod(ends, ends, ends)
    condition = rows(kind, 8)[0].repeat_interleave(len(u), 0)
    assert_consistent(ready(name, kind, fitted), condition, u.repeat(8, 1))


@each
def test_largest_radius(name):
    """At the largest radius that uniforms give, rounding puts points on either side of the rim."""
    kind = "tilted" if name != "native" else "mitsuba"
    method, (condition, u) = ready(name, kind, True), rows(kind, 4096)
    for column in range(2):
        edge = u.clone()
        edge[:, column] = TOP
        assert_consistent(method, condition, edge)


@each
@small
def test_pdf_off_the_disk(name, kind, fitted):
    """Off the disk and on its rim the density is that of the sampler: finite, not negative."""
    condition = rows(kind, 6)[0]
    wo = torch.tensor([[1.0, 0.0], [0, -1], [0.8, 0.8], [2, 0], [-30, 40], [1e4, -1e4]])
    pdf = ready(name, kind, fitted).pdf(condition, wo)
    assert pdf.isfinite().all() and (pdf >= 0).all()


@each
@small
def test_batch_sizes(name, kind, fitted):
    """A row's result does not depend on the rows beside it; no rows are allowed."""
    method = ready(name, kind, fitted)
    condition, u = rows(kind, 1001)
    wo, pdf = method.sample(condition, u)
    for n in (0, 1, 7):
        part = method.sample(condition[:n], u[:n])
        assert part.wo.shape == (n, 2) and part.pdf.shape == (n,)
        torch.testing.assert_close(part.wo, wo[:n], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(part.pdf, method.pdf(condition[:n], part.wo), rtol=1e-4, atol=0)
        assert method.pdf(condition[:n], wo[:n]).shape == (n,)


@each
@small
def test_rows_stay_apart(name, kind, fitted):
    """A row of nan leaves its neighbours as they are."""
    method = ready(name, kind, fitted)
    condition, u = rows(kind, 9)
    wo, pdf = method.sample(condition, u)
    broken = condition.clone()
    broken[4] = math.nan
    others = torch.arange(9) != 4
    sample = method.sample(broken, u)
    torch.testing.assert_close(sample.wo[others], wo[others], rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(sample.pdf[others], pdf[others], rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(method.pdf(broken, wo)[others], pdf[others], rtol=1e-4, atol=1e-6)


@each
@small
def test_inputs_are_left_alone(name, kind, fitted):
    """Neither ``sample`` nor ``pdf`` writes to what it is given; the results are the caller's."""
    method = ready(name, kind, fitted)
    condition, u = rows(kind, 33)
    before = condition.clone(), u.clone()
    wo, pdf = method.sample(condition, u)
    kept = wo.clone(), pdf.clone()
    density = method.pdf(condition, wo)
    method.sample(condition, u.flip(0))
    assert torch.equal(condition, before[0]) and torch.equal(u, before[1])
    assert torch.equal(wo, kept[0]) and torch.equal(pdf, kept[1])
    assert torch.equal(method.pdf(condition, wo), density)


@each
@small
def test_state_round_trip(name, kind, fitted):
    """State is all there is: a fresh method with that state samples the same."""
    method = ready(name, kind, fitted)
    state = {key: value.clone() for key, value in method.state_dict().items()}
    other = new(name)
    other.bind(material(kind))
    other.load_state_dict(state)
    for key, value in other.state_dict().items():
        assert torch.equal(value, state[key])
    condition, u = rows(kind, 257)
    wo, pdf = method.sample(condition, u)
    sample = other.sample(condition, u)
    torch.testing.assert_close(sample.wo, wo)
    torch.testing.assert_close(sample.pdf, pdf, rtol=1e-4, atol=0)


@each
@cases
def test_twins_agree(name, kind, fitted):
    """The density that is fitted is the one that is used."""
    method = ready(name, kind, fitted)
    if not hasattr(method, "log_prob"):
        pytest.skip("fits no density in torch")
    condition = rows(kind, 64)[0]
    wo = cells(8)
    with torch.no_grad():
        fit = method.log_prob(condition, wo.expand(64, -1, -1)).exp()
    use = method.pdf(condition.repeat_interleave(64, 0), wo.repeat(64, 1)).view(64, 64)
    if name.startswith("histogram"):
        # A step density: a point within rounding of an edge may fall in either cell.
        apart = ~torch.isclose(use, fit, rtol=1e-4, atol=1e-5)
        assert apart.double().mean() < 2e-3
    else:
        torch.testing.assert_close(use, fit, rtol=1e-4, atol=1e-5)


@each
def test_fit_helps(name):
    """A fit comes closer to the target than the method it started from."""
    method, report = _ready(name, "tilted", True)
    assert report is not None
    if report.steps == 0:
        pytest.skip("nothing to fit")
    assert report.parameters > 0 and np.isfinite(report.loss).all()
    assert divergence(method, material("tilted")) < divergence(
        ready(name, "tilted", False), material("tilted")
    )


def divergence(method: Method, of: Material, n: int = 64, resolution: int = 32) -> float:
    """Mean KL(p* || p) over random conditions."""
    condition = of.conditions(n, torch.Generator().manual_seed(7))
    target = tabulate(of, condition, resolution).double().flatten(1)
    mass = target / target.sum(1, keepdim=True)
    count = resolution**2
    wo = cells(resolution).repeat(n, 1)
    pdf = method.pdf(condition.repeat_interleave(count, 0), wo).double().view(n, count)
    return float((mass * (mass * count / math.pi / pdf).log()).sum(1).mean())


@st.composite
def tilted_rows(draw) -> tuple[Tensor, Tensor]:
    """Conditions of the tilted material, ``wi`` up to the rim, features of any size; uniforms."""
    number = st.floats(-1e6, 1e6, width=32) | st.floats(0, 1, width=32)
    unit = st.floats(0, TOP, width=32) | st.sampled_from([0.0, TOP])
    radius = st.floats(0, 1, width=32) | st.sampled_from([0.0, 1.0])
    row = st.tuples(number, number, radius, st.floats(0, 7, width=32), unit, unit, unit)
    values = torch.tensor(draw(st.lists(row, min_size=1, max_size=24)))
    wi = values[:, 2:3] * torch.stack([values[:, 3].cos(), values[:, 3].sin()], -1)
    return torch.cat([values[:, :2], wi], 1), values[:, 4:]


@each
@pytest.mark.parametrize(
    "fitted", [pytest.param(False, marks=pytest.mark.slow), True], ids=["untrained", "fitted"]
)
def test_any_row(name, fitted):
    """Whatever the condition and the uniforms: finite, consistent, and the input unharmed."""
    method = ready(name, "tilted", fitted)

    @settings(max_examples=25, deadline=None, derandomize=True, database=None)
    @given(tilted_rows())
    def check(drawn: tuple[Tensor, Tensor]) -> None:
        condition, u = drawn
        before = condition.clone(), u.clone()
        assert_consistent(method, condition, u)
        assert torch.equal(condition, before[0]) and torch.equal(u, before[1])

    check()
