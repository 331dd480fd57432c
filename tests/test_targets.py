"""Directions drawn from p*: that they follow it, however narrow its peaks, and their weights."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.fitting.drawn import GROUPS, Drawn
from harness.fitting.quadtree import ROUNDS, Quadtree
from harness.fitting.targets import Targets, _cache, tabulate
from harness.stats.chisquare import chi_square
from tests.materials import MATERIALS, HalfBlack, Tilted

BUDGET = Budget(steps=30, conditions=16, directions=16, resolution=16, pool=64)


def generator(seed: int = 0) -> torch.Generator:
    """Seeded."""
    return torch.Generator().manual_seed(seed)


class Needle(Material):
    """p* is half uniform, half a Gaussian of ``width`` that lies wholly inside the disk.

    Around the mirrored direction, or around ``place``.
    """

    name = "needle"

    def __init__(self, width: float, place: tuple[float, float] | None = None):
        self.width, self.place = width, place

    def centre(self, condition: Tensor) -> Tensor:
        """Of the peak, [N, 2]."""
        return -condition if self.place is None else condition.new_tensor(self.place)

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        apart = (wo - self.centre(condition)).square().sum(-1) / self.width**2
        peak = torch.exp(-apart / 2) / (2 * math.pi * self.width**2)
        return torch.where(inside_disk(wo), peak + 1 / math.pi, 0)[:, None].expand(-1, 3)

    def conditions(self, n: int, generator: torch.Generator, device: str = "cpu") -> Tensor:
        """Far enough from the rim."""
        return 0.9 * super().conditions(n, generator, device)

    def identity(self) -> dict:
        """See :meth:`Material.identity`."""
        return {"type": "needle", "width": self.width, "place": self.place}


class Broken(HalfBlack):
    """Nan in a part of the conditions."""

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        return torch.where(condition[:, :1] > 0.5, math.nan, super().eval(condition, wo))


class Black(HalfBlack):
    """Reflects nothing."""

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        return torch.zeros(len(wo), 3)


# --- where directions are ----------------------------------------------------------------

NEEDLES = {"mirrored": Needle(0.004), "elsewhere": Needle(0.012, (0.3, -0.4))}


@pytest.mark.parametrize("case", NEEDLES)
@pytest.mark.parametrize("groups", [False, True], ids=["batch", "drawn"])
def test_directions_follow_peaks_narrower_than_a_cell(case, groups):
    """Chi-square over rings around the peak, against p* in closed form.

    A cell of a table of 64 x 64 is 0.03 wide.
    """
    material = NEEDLES[case]
    targets = Targets.build(material, Budget(pool=256, directions=4), generator())
    if groups:
        condition, wo = Drawn(targets, 4, generator(1)).batch(4096, generator(2))
    else:
        condition, wo = targets.batch(4096, 4, generator(1))
    assert fit_to_rings(material, condition, wo) > 1e-3


def fit_to_rings(material: Needle, condition: Tensor, wo: Tensor) -> float:
    """p-value of ``wo`` [B, D, 2]: counts in rings around the peak and outside of them.

    Stratified directions have counts that vary less than those of independent ones.
    """
    centre = material.centre(condition).expand(len(condition), 2)
    apart = (wo - centre[:, None]).norm(dim=-1)
    edges = material.width * np.array([0, 0.5, 1, 1.5, 2, 3, 5])
    inside = 0.5 * (1 - np.exp(-((edges / material.width) ** 2) / 2)) + 0.5 * edges**2
    expected = np.append(np.diff(inside), 1 - inside[-1]) * apart.numel()
    return chi_square(np.histogram(apart.numpy(), [*edges, 3])[0], expected).p_value


def test_directions_of_a_table_do_not_pass():
    """The test above notices directions that are spread over the cells of a table of 64 x 64."""
    material = Needle(0.012, (0.3, -0.4))
    mass = tabulate(material, torch.zeros(1, 2), 2048)[0].double()
    mass = mass.view(64, 32, 64, 32).sum((1, 3)).flatten() / mass.sum()
    cell = mass.multinomial(16384, replacement=True, generator=generator())
    corner = torch.stack([cell // 64, cell % 64], -1)
    wo = square_to_disk((corner + torch.rand(16384, 2, generator=generator())) / 64)
    assert fit_to_rings(material, torch.zeros(1, 2), wo[None]) < 1e-9


def test_resolution_changes_nothing():
    """Of the budget: what is drawn is the same, and its share in the peak is that of p*."""
    material, shares = Needle(0.006), []
    for resolution in (8, 256):
        targets = Targets.build(material, Budget(pool=64, resolution=resolution), generator(3))
        apart = (targets.wo + targets.condition[:, None]).norm(dim=-1)
        shares.append((targets.mass * (apart < 3 * material.width)).sum(1).double())
        _cache.clear()
    assert torch.equal(*shares)
    exact = 0.5 * (1 - math.exp(-4.5)) + 0.5 * (3 * material.width) ** 2
    assert abs(float(shares[0].mean()) - exact) < 5 * float(shares[0].std()) / 8
    assert float(shares[0].std()) < 0.05


def test_cells_cover_the_square():
    """Areas sum to one and no two cells overlap, after all cuts, with peaks off the square too."""
    peaks = torch.tensor([[[0.3, 0.7], [1.4, 0.2]], [[0.0, 0.0], [0.999, 0.999]]])

    def density(point: Tensor) -> Tensor:
        return torch.exp(-50 * (point - 0.6).square().sum(-1))

    tree = Quadtree.build(density, 2, 8, peaks, generator())
    area = tree.size.square().sum(1)
    torch.testing.assert_close(area, torch.ones(2))
    at = torch.rand(100, 1, 2, generator=generator(1))
    for corner, size in zip(tree.corner, tree.size, strict=True):
        inside = ((at >= corner) & (at < corner + size[:, None])).all(-1)
        assert (inside.sum(1) == 1).all()
    corner, size = tree.corner[1], tree.size[1]
    inside = ((peaks[1, 1] >= corner) & (peaks[1, 1] < corner + size[:, None])).all(-1)
    assert float(size[inside]) == 1 / (8 << ROUNDS)


# --- weights -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", MATERIALS)
def test_weights_integrate(kind):
    """Mass sums to one; areas give integrals over the disk; density is p* there."""
    material = MATERIALS[kind]()
    targets = Targets.build(material, BUDGET, generator())
    assert targets.wo.shape == (64, 1024, 2) and targets.black == targets.broken == 0
    assert inside_disk(targets.wo).all() and targets.seconds > 0 and targets.notes == ""
    torch.testing.assert_close(targets.mass.sum(1), torch.ones(64), rtol=1e-5, atol=0)
    x, y = targets.wo.double().unbind(-1)
    for value, exact in ((1 + 0 * x, math.pi), (x * x + y * y, math.pi / 2), (x, 0.0)):
        found = (targets.area * value).sum(1)
        assert abs(float(found.mean()) - exact) < 5 * float(found.std()) / 8
    table = tabulate(material, targets.condition, 128).double()
    total = table.sum((1, 2))[:, None] * (math.pi / 128**2)
    rows = targets.condition.repeat_interleave(1024, 0)
    value = material.target(rows, targets.wo.reshape(-1, 2)).view(64, 1024)
    # Normalised by its own directions, which are a sample.
    torch.testing.assert_close(targets.density.double(), value / total, rtol=0.1, atol=1e-9)


def test_mixed_draws_have_the_expectation_of_uniform_ones():
    """Weighted means of p* and of its square agree with those over a fine table."""
    targets = Targets.build(Tilted(), Budget(pool=64), generator(5))
    condition, wo, density, weight = targets.mixed(256, 512, generator())
    assert inside_disk(wo).all() and float(weight.max()) <= 2
    table = tabulate(Tilted(), condition, 128).double().flatten(1)
    table = table / table.sum(1, keepdim=True) * (128**2 / math.pi)
    for function in (lambda p: p, lambda p: p.square(), torch.ones_like):
        found, exact = (weight * function(density)).double().mean(1), function(table).mean(1)
        ratio = (found / exact).view(-1)
        assert abs(float(ratio.mean()) - 1) < 0.02


def test_black_conditions_are_left_out():
    """And counted; black directions are never drawn."""
    targets = Targets.build(HalfBlack(), BUDGET, generator())
    assert 16 < targets.black < 48 and targets.broken == 0
    assert len(targets.condition) == len(targets.wo) == 64 - targets.black
    assert targets.notes == f"{targets.black} black conditions left out"
    assert (targets.condition[:, 0] >= 0).all()
    _, wo = targets.batch(64, 64, generator(1))
    assert (wo[..., 0] >= 0).all()


def test_conditions_without_a_number_are_told_from_black_ones():
    """Nan is not darkness."""
    targets = Targets.build(Broken(), BUDGET, generator())
    black = Targets.build(HalfBlack(), BUDGET, generator()).black
    assert targets.black == black and targets.broken > 5
    assert targets.notes.endswith(f"{targets.broken} conditions left out where f is not finite")
    assert targets.density.isfinite().all() and (targets.condition[:, 0] <= 0.5).all()


def test_material_that_is_black_everywhere():
    """Is refused, with the reason."""
    with pytest.raises(InputError, match="in none of 64 conditions is light reflected"):
        Targets.build(Black(), BUDGET, generator())


# --- draws -------------------------------------------------------------------------------


def test_methods_share_targets():
    """Made once for equal generators; not for another seed, material or budget."""
    material = Tilted()
    first = Targets.build(material, BUDGET, generator())
    assert Targets.build(material, BUDGET, generator()) is first
    steps = Budget(**{**vars(BUDGET), "steps": 7, "resolution": 64})
    assert Targets.build(material, steps, generator()) is first
    other = Targets.build(material, BUDGET, generator(1))
    assert not torch.equal(other.condition, first.condition)
    assert Targets.build(Tilted(), BUDGET, generator()) is not other
    again = Targets.build(material, BUDGET, generator())
    assert again is not first and torch.equal(again.wo, first.wo)
    more = Targets.build(material, Budget(**{**vars(BUDGET), "directions": 512}), generator())
    assert more.wo.shape[1] == 2048


def test_generator_moves_on_alike():
    """Whether the directions were drawn or found."""
    material, states = Tilted(), []
    for _ in range(2):
        own = generator(3)
        Targets.build(material, BUDGET, own)
        states.append(own.get_state())
    assert torch.equal(*states)


def test_draws_depend_on_the_generator_alone():
    """Equal generators, equal draws."""
    targets = Targets.build(Tilted(), Budget(pool=8), generator())
    for draw in (targets.batch, targets.mixed):
        first, same, other = (draw(4, 6, generator(s)) for s in (0, 0, 1))
        assert all(torch.equal(a, b) for a, b in zip(first, same, strict=True))
        assert not torch.equal(first[1], other[1])


def test_groups_share_a_condition_evenly():
    """Each group of a condition is spread over p*: its mean is nearer to it than of free draws."""
    targets = Targets.build(Tilted(), Budget(pool=64), generator())
    drawn = Drawn(targets, 16, generator(1))
    assert drawn.wo.shape == (64, GROUPS, 16, 2)
    whole = (targets.mass[..., None] * targets.wo).sum(1)
    free = (targets.mass[..., None] * (targets.wo - whole[:, None]).square()).sum((1, 2)) / 16
    apart = (drawn.wo.mean(2) - whole[:, None]).square().sum(-1).mean(1)
    assert float((apart / free).mean()) < 0.5
