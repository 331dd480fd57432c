"""The floor: the disk and its maps, densities on it, and what a method has by default."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from torch import Tensor

from harness.core.protocol.disk import (
    cos_theta,
    disk_to_solid_angle,
    disk_to_square,
    inside_disk,
    luminance,
    solid_angle_to_disk,
    square_to_disk,
    to_direction,
)
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, FitReport, Method
from harness.stats.chisquare import chi_square
from tests.materials import Plain, Tilted

TOP = 1 - 2**-24
"""The largest single-precision number below one."""

unit = st.floats(0, TOP, width=32) | st.sampled_from([0.0, 2.0**-24, 0.25, 0.5, 0.75, TOP])
points = hnp.arrays(np.float32, st.tuples(st.integers(0, 40), st.just(2)), elements=unit)
each_example = settings(max_examples=60, deadline=None, derandomize=True, database=None)


class Half(Method):
    """The smallest adapter: uniform on the disk."""

    name = "half"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo = square_to_disk(u[:, :2])
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(inside_disk(wo), 1 / math.pi, 0)


# --- the map between square and disk ---------------------------------------------------


def test_uniform_square_gives_uniform_disk():
    """Equal areas of the disk get equal counts: rings of equal area times equal sectors."""
    n, rings, sectors = 200_000, 16, 24
    wo = square_to_disk(torch.rand(n, 2, generator=torch.Generator().manual_seed(0)))
    ring = (wo.square().sum(-1) * rings).long()
    sector = ((torch.atan2(wo[:, 1], wo[:, 0]) / (2 * math.pi) + 0.5) * sectors).long() % sectors
    observed = torch.bincount(ring * sectors + sector, minlength=rings * sectors)
    assert len(observed) == rings * sectors
    expected = np.full(len(observed), n / len(observed))
    assert chi_square(observed, expected).p_value > 1e-3


def test_jacobian_is_pi():
    """By differences in double precision, away from the diagonals, where the map has kinks."""
    u = torch.rand(2000, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    a, b = (2 * u - 1).abs().unbind(-1)
    u = u[((a - b).abs() > 1e-4) & (a > 1e-4) & (b > 1e-4)]
    h = 1e-7
    along = [
        (square_to_disk(u + h * torch.eye(2)[i]) - square_to_disk(u - h * torch.eye(2)[i]))
        / (2 * h)
        for i in (0, 1)
    ]
    determinant = along[0][:, 0] * along[1][:, 1] - along[0][:, 1] * along[1][:, 0]
    torch.testing.assert_close(
        determinant.abs(), torch.full_like(determinant, math.pi), rtol=1e-5, atol=0
    )


@each_example
@given(points)
def test_maps_are_inverse(array):
    """In both precisions; the input is left as it was; every image is a direction."""
    for u in (torch.tensor(array), torch.tensor(array).double()):
        before = u.clone()
        wo = square_to_disk(u)
        assert wo.shape == u.shape and wo.dtype == u.dtype
        assert torch.equal(u, before)
        assert inside_disk(wo).all() and (cos_theta(wo) > 0).all()
        eps = torch.finfo(u.dtype).eps
        torch.testing.assert_close(disk_to_square(wo), u, rtol=0, atol=16 * eps)


def test_every_bound_stays_inside():
    """All combinations of the first and last uniforms, the diagonals and the axes."""
    ends = torch.tensor([0.0, 2.0**-24, 0.25, 0.5 - 2.0**-25, 0.5, 0.5 + 2.0**-24, 0.75, TOP])
    wo = square_to_disk(torch.cartesian_prod(ends, ends))
    assert wo.isfinite().all() and inside_disk(wo).all()
    # The edge of the square lies at the rim, not noticeably inside it.
    assert wo[:8].norm(dim=-1).min() > 1 - 1e-6
    assert torch.equal(square_to_disk(torch.tensor([0.5, 0.5])), torch.zeros(2))


def test_whole_edge_stays_inside():
    """Rounding of sine and cosine puts no point of the edge on the rim."""
    t = torch.rand(200_000, generator=torch.Generator().manual_seed(2))
    for edge in (0.0, TOP):
        for u in (
            torch.stack([torch.full_like(t, edge), t], -1),
            torch.stack([t, torch.full_like(t, edge)], -1),
        ):
            assert inside_disk(square_to_disk(u)).all()


def test_leading_shapes():
    """Any, also none and empty."""
    u = torch.rand(3, 5, 2, generator=torch.Generator().manual_seed(3))
    wo = square_to_disk(u)
    assert torch.equal(wo[1, 2], square_to_disk(u[1, 2]))
    assert torch.equal(disk_to_square(wo)[1, 2], disk_to_square(wo[1, 2]))
    assert square_to_disk(u[:0]).shape == (0, 5, 2) == disk_to_square(u[:0]).shape
    assert cos_theta(wo).shape == (3, 5) and to_direction(wo).shape == (3, 5, 3)


@each_example
@given(st.floats(1.0001, 1e4), st.floats(-math.pi, math.pi))
def test_outside_the_disk_is_outside_the_square(radius, turn):
    """A point off the disk is binned with no cell."""
    u = disk_to_square(radius * torch.tensor([math.cos(turn), math.sin(turn)]))
    assert ((u < 0) | (u > 1)).any()


# --- directions and densities ----------------------------------------------------------


@each_example
@given(points)
def test_directions_are_unit_vectors(array):
    """Above the surface, over the same point of the disk."""
    wo = square_to_disk(torch.tensor(array))
    direction = to_direction(wo)
    assert torch.equal(direction[..., :2], wo)
    assert (direction[..., 2] > 0).all()
    torch.testing.assert_close(direction.norm(dim=-1), torch.ones(len(wo)), rtol=1e-6, atol=0)


def test_off_the_disk():
    """Not inside, and of cosine zero, the rim included; nan is not inside either."""
    wo = torch.tensor([[1.0, 0.0], [0, -1], [0.8, 0.8], [-3, 4], [math.nan, 0]])
    assert not inside_disk(wo).any()
    assert (cos_theta(wo)[:4] == 0).all()
    assert cos_theta(wo)[4].isnan()


@each_example
@given(points, st.just(0.0) | st.floats(1e-20, 1e6))
def test_densities_round_trip(array, density):
    """Disk to solid angle and back."""
    wo = square_to_disk(torch.tensor(array))
    pdf = torch.full((len(wo),), density)
    torch.testing.assert_close(
        solid_angle_to_disk(disk_to_solid_angle(pdf, wo), wo), pdf, rtol=1e-6, atol=0
    )


def test_uniform_disk_is_the_cosine_hemisphere():
    """1/pi per disk area is cos/pi per steradian, whose integral over the hemisphere is one."""
    z = (torch.arange(512, dtype=torch.float64) + 0.5) / 512
    phi = (torch.arange(64, dtype=torch.float64) + 0.5) * (2 * math.pi / 64)
    zz, pp = torch.meshgrid(z, phi, indexing="ij")
    sine = (1 - zz * zz).sqrt()
    wo = torch.stack([sine * pp.cos(), sine * pp.sin()], -1)
    pdf = disk_to_solid_angle(torch.full_like(zz, 1 / math.pi), wo)
    torch.testing.assert_close(pdf, zz / math.pi)
    # d omega = dz dphi, and every node stands for an equal share of the 2 pi steradians.
    assert float(pdf.mean() * 2 * math.pi) == pytest.approx(1, abs=1e-12)
    uniform = solid_angle_to_disk(torch.full_like(zz, 1 / (2 * math.pi)), wo)
    torch.testing.assert_close(uniform, 1 / (2 * math.pi * zz))


def test_rim_has_no_density_per_disk_area():
    """The quotient there is what it is: neither floored nor zeroed."""
    rim = torch.tensor([[1.0, 0.0]])
    assert solid_angle_to_disk(torch.tensor([0.5]), rim).isinf().all()
    assert solid_angle_to_disk(torch.tensor([0.0]), rim).isnan().all()


def test_luminance_is_mitsubas():
    """The same weights, hence the same targets in torch and in the renderer."""
    from harness.mitsuba_runtime import variant

    mi = variant.use("cpu")
    rgb = torch.rand(100, 3, generator=torch.Generator().manual_seed(4)) * 10 - 2
    theirs = mi.luminance(mi.Color3f(rgb.T.contiguous().numpy())).numpy()
    np.testing.assert_allclose(luminance(rgb).numpy(), theirs, rtol=1e-5, atol=1e-6)
    assert luminance(rgb.view(4, 25, 3)).shape == (4, 25)
    assert float(luminance(torch.ones(3))) == pytest.approx(1)


# --- what a method and a material have by default --------------------------------------


def test_method_defaults():
    """Fits nothing, has no state, supports anything, and reflects what its material does."""
    method, material = Half(), Plain()
    condition = material.conditions(5, torch.Generator().manual_seed(0))
    wo = square_to_disk(condition[:, :2].abs())
    with pytest.raises(RuntimeError, match="half: eval before fit or bind"):
        method.eval(condition, wo)
    assert method.supports(material) == (True, "")
    report = method.fit(material, Budget(), torch.Generator())
    assert report == FitReport() and report.loss == [] and report.parameters == 0
    assert method.material is material
    assert torch.equal(method.eval(condition, wo), material.eval(condition, wo))
    assert method.state_dict() == {} and method.size_bytes() == 0
    assert method.load_state_dict({}) is None
    assert method.uniforms == 3


def test_method_needs_both_halves():
    """A sampler without its density is none."""

    class Sampler(Method):
        def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
            return DiskSample(u[:, :2], u[:, 0])

    with pytest.raises(TypeError, match="pdf"):
        Sampler()


def test_size_counts_bytes_as_stored():
    """Of every dtype."""

    class Stateful(Half):
        def state_dict(self) -> dict[str, Tensor]:
            return {"a": torch.zeros(3, 5), "b": torch.zeros(7, dtype=torch.uint8)}

    assert Stateful().size_bytes() == 67


def test_disk_sample_unpacks_in_order():
    """Directions first."""
    wo, pdf = DiskSample(torch.zeros(4, 2), torch.ones(4))
    assert wo.shape == (4, 2) and pdf.shape == (4,)


def test_reports_share_no_list():
    """Each fit has its own history."""
    FitReport().loss.append(1.0)
    assert FitReport().loss == []


def test_budget_cannot_be_written_to():
    """One budget serves many fits."""
    with pytest.raises(AttributeError):
        Budget().steps = 3


def test_conditions_of_a_material():
    """Rows ``[address, features, wi]`` of the stated width, the same for an equal generator."""
    material = Tilted()
    draws = [material.conditions(6, torch.Generator().manual_seed(s)) for s in (0, 0, 1)]
    assert draws[0].shape == (6, material.n_condition) == (6, 4)
    assert torch.equal(draws[0], draws[1]) and not torch.equal(draws[0], draws[2])
    assert inside_disk(draws[0][:, -2:]).all()
    assert material.conditions(0, torch.Generator()).shape == (0, 4)


def test_target_takes_the_size_of_negative_data():
    """A measured material's negative lobe is sampled too, in proportion to its size."""

    class Negative(Plain):
        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            return -super().eval(condition, wo)

    condition = Plain().conditions(4, torch.Generator().manual_seed(0))
    wo = square_to_disk(torch.rand(4, 2, generator=torch.Generator().manual_seed(1)))
    target = Plain().target(condition, wo)
    assert (target > 0).all()
    assert torch.equal(Negative().target(condition, wo), target)


def test_features_need_places():
    """A material that names features has to say what they are."""

    class Forgetful(Plain):
        n_features = 1

    with pytest.raises(NotImplementedError, match="places"):
        Forgetful().conditions(2, torch.Generator())
    assert isinstance(Plain(), Material)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("cosin", "; did you mean 'cosine'?"),
        ("zzz", "; known: blinn-phong, cosine"),
    ],
)
def test_nearest_name(name, hint):
    """The nearest one, or all of them."""
    assert nearest(name, ["cosine", "blinn-phong"]) == hint
    assert nearest(name, []) == ""
    assert issubclass(InputError, ValueError)
