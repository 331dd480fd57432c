"""Tabulated targets, draws from them, and the training loop."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from harness._methods.improved_baseline import ImprovedBaseline
from harness.core.protocol.disk import disk_to_square, inside_disk
from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.method import Budget
from harness.fitting.targets import Targets, cells, tabulate
from harness.fitting.train import minimise
from harness.stats.chisquare import chi_square
from tests.materials import MATERIALS, HalfBlack, Plain, Tilted

BUDGET = Budget(steps=30, conditions=16, directions=16, resolution=16, pool=64)


def generator(seed: int = 0) -> torch.Generator:
    """Seeded."""
    return torch.Generator().manual_seed(seed)


def cell_of(wo: Tensor, resolution: int) -> Tensor:
    """Index of the cell of the table that holds ``wo`` [..., 2]."""
    index = (disk_to_square(wo.double()) * resolution).long().clamp(0, resolution - 1)
    return index[..., 0] * resolution + index[..., 1]


def row_of(condition: Tensor, pool: Tensor) -> Tensor:
    """Index in ``pool`` [P, C] of each of ``condition`` [B, C]."""
    same = (condition[:, None] == pool).all(-1)
    assert (same.sum(1) == 1).all()
    return same.long().argmax(1)


# --- tables ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", MATERIALS)
def test_table_is_the_target(kind):
    """``tabulate``, ``target_grid`` and ``target`` are one function."""
    material = MATERIALS[kind]()
    condition = material.conditions(5, generator())
    wo = cells(8)
    table = tabulate(material, condition, 8)
    assert table.shape == (5, 8, 8)
    one_by_one = torch.stack([material.target(c.expand(64, -1), wo) for c in condition])
    torch.testing.assert_close(table.view(5, 64), one_by_one, rtol=1e-5, atol=1e-7)
    shared = material.target_grid(condition, wo[None])
    torch.testing.assert_close(shared, one_by_one, rtol=1e-5, atol=1e-7)
    own = torch.rand(5, 64, 2, generator=generator(1))
    moved = cells(8, own)
    each = torch.stack(
        [material.target(c.expand(64, -1), w) for c, w in zip(condition, moved, strict=True)]
    )
    torch.testing.assert_close(material.target_grid(condition, moved), each, rtol=1e-5, atol=1e-7)
    assert material.target_grid(condition[:0], wo[None]).shape == (0, 64)


@pytest.mark.parametrize("jittered", [False, True])
def test_every_cell_has_its_point(jittered):
    """In the order of the table, inside the disk."""
    jitter = torch.rand(3, 144, 2, generator=generator()) if jittered else None
    wo = cells(12, jitter)
    assert wo.shape == ((3, 144, 2) if jittered else (144, 2))
    assert inside_disk(wo).all()
    assert torch.equal(cell_of(wo, 12), torch.arange(144).expand(wo.shape[:-1]))


def test_tables_in_pieces_are_the_same(monkeypatch):
    """However many rows a call to the material takes."""
    from harness.fitting import targets

    condition = Plain().conditions(9, generator())
    whole = tabulate(Plain(), condition, 8), tabulate(Plain(), condition, 8, generator(1))
    for rows in (1, 3, 4):
        monkeypatch.setattr(targets, "_ROWS", 64 * rows)
        torch.testing.assert_close(tabulate(Plain(), condition, 8), whole[0])
        torch.testing.assert_close(tabulate(Plain(), condition, 8, generator(1)), whole[1])


# --- targets ---------------------------------------------------------------------------


@pytest.mark.parametrize("kind", MATERIALS)
def test_mass_sums_to_one(kind):
    """For every condition, in the units of the budget."""
    targets = Targets.build(MATERIALS[kind](), BUDGET, generator())
    assert targets.mass.shape == (64, 16, 16) and targets.resolution == 16
    assert len(targets.condition) == 64 and targets.black == 0
    torch.testing.assert_close(targets.mass.sum((1, 2)), torch.ones(64), rtol=1e-5, atol=0)
    assert (targets.mass >= 0).all() and targets.seconds > 0


def test_black_conditions_are_left_out():
    """And counted; black directions have no mass."""
    targets = Targets.build(HalfBlack(), BUDGET, generator())
    assert 16 < targets.black < 48
    assert len(targets.condition) == len(targets.mass) == 64 - targets.black
    assert (targets.condition[:, 0] >= 0).all()
    _, wo = targets.batch(16, 64, generator(1))
    assert (wo[..., 0] > -1e-6).all()


def test_methods_share_tables():
    """Made once for equal generators; not for another seed, material or budget."""
    material = Tilted()
    first = Targets.build(material, BUDGET, generator())
    assert Targets.build(material, BUDGET, generator()) is first
    steps = Budget(**{**vars(BUDGET), "steps": 7})
    assert Targets.build(material, steps, generator()) is first
    other = Targets.build(material, BUDGET, generator(1))
    assert not torch.equal(other.condition, first.condition)
    assert Targets.build(Tilted(), BUDGET, generator()) is not other
    again = Targets.build(material, BUDGET, generator())
    assert again is not first and torch.equal(again.mass, first.mass)
    finer = Targets.build(material, Budget(**{**vars(BUDGET), "resolution": 8}), generator())
    assert finer.resolution == 8


def test_generator_moves_on_alike():
    """Whether the table was made or found."""
    material, states = Tilted(), []
    for _ in range(2):
        own = generator(3)
        Targets.build(material, BUDGET, own)
        states.append(own.get_state())
    assert torch.equal(*states)


# --- draws -----------------------------------------------------------------------------


def few() -> Targets:
    """Two conditions, so that each is drawn often."""
    return Targets.build(Tilted(), Budget(resolution=16, pool=2), generator(5))


def test_batch_follows_mass():
    """Chi-square over the cells, and rows are drawn evenly."""
    targets = few()
    condition, wo = targets.batch(64, 2000, generator())
    assert condition.shape == (64, 4) and wo.shape == (64, 2000, 2)
    assert inside_disk(wo).all()
    row = row_of(condition, targets.condition)
    assert 16 < int(row.sum()) < 48
    cell = cell_of(wo, 16)
    for i in range(2):
        observed = torch.bincount(cell[row == i].flatten(), minlength=256)
        expected = targets.mass[i].flatten().double() * int((row == i).sum()) * 2000
        assert chi_square(observed, expected / expected.sum() * observed.sum()).p_value > 1e-3


def test_batch_fills_its_cells():
    """Directions are uniform within a cell."""
    _, wo = few().batch(64, 2000, generator(1))
    within = (disk_to_square(wo.double()) * 16 % 1).view(-1, 2)
    observed = np.histogram2d(*within.T.numpy(), bins=8, range=[[0, 1], [0, 1]])[0]
    assert chi_square(observed, np.full(64, len(within) / 64)).p_value > 1e-3


def test_uniform_density():
    """Directions are uniform; the density is the table's at them, and integrates to one."""
    targets = few()
    condition, wo, density = targets.uniform(64, 2000, generator())
    assert wo.shape == (64, 2000, 2) and density.shape == (64, 2000)
    cell = cell_of(wo, 16)
    observed = torch.bincount(cell.flatten(), minlength=256)
    assert chi_square(observed, np.full(256, 500.0)).p_value > 1e-3
    row = row_of(condition, targets.condition)
    mass = targets.mass.flatten(1)[row].gather(1, cell)
    # A point on the border of two cells may round into the other.
    same = (density - mass * (256 / math.pi)).abs() <= 1e-5 * density
    assert same.double().mean() > 0.9999
    integral = density.double().mean(1) * math.pi
    error = density.double().std(1) * math.pi / math.sqrt(2000)
    assert ((integral - 1).abs() < 5 * error).all()


def test_mixed_draws_have_the_expectation_of_uniform_ones():
    """Weighted means of p* agree with the sum over its cells."""
    targets = few()
    condition, wo, density, weight = targets.mixed(64, 2000, generator())
    assert inside_disk(wo).all()
    row = row_of(condition, targets.condition)
    mass = targets.mass.flatten(1).double()[row]
    torch.testing.assert_close(
        weight.double().mean(), torch.tensor(1.0).double(), rtol=0, atol=0.02
    )
    for function in (lambda p: p, lambda p: p.square()):
        found = (weight * function(density)).double().mean(1)
        exact = function(mass * (256 / math.pi)).mean(1)
        # Weights are at most two, so 2000 draws are normal enough.
        error = (weight * function(density)).double().std(1) / math.sqrt(2000)
        assert ((found - exact).abs() < 5 * error).all()


def test_draws_depend_on_the_generator_alone():
    """Equal generators, equal draws."""
    targets = few()
    for draw in (targets.batch, targets.uniform, targets.mixed):
        first, same, other = (draw(4, 6, generator(s)) for s in (0, 0, 1))
        assert all(torch.equal(a, b) for a, b in zip(first, same, strict=True))
        assert not torch.equal(first[1], other[1])


# --- the training loop -----------------------------------------------------------------


class Table(nn.Module):
    """A histogram of 16 x 16 cells, the same for every condition."""

    def __init__(self) -> None:
        super().__init__()
        self.logits = nn.Parameter(torch.zeros(256))

    def log_prob(self, wo: Tensor) -> Tensor:
        """Log density at ``wo`` [..., 2]."""
        log_mass = torch.log_softmax(self.logits, 0)
        return log_mass[cell_of(wo, 16)] + math.log(256 / math.pi)


def fit(targets: Targets, budget: Budget, seed: int = 0) -> tuple[Table, list[float]]:
    """By maximum likelihood."""
    table, own = Table(), generator(seed)

    def loss() -> Tensor:
        _, wo = targets.batch(budget.conditions, budget.directions, own)
        return -table.log_prob(wo).mean()

    report = minimise(table, loss, targets, budget, learning_rate=0.05)
    assert report.steps == budget.steps and report.parameters == 256
    assert report.optimise_seconds > 0 and report.data_seconds == targets.seconds
    assert len(report.part_seconds) == 12 and all(part > 0 for part in report.part_seconds)
    assert sum(report.part_seconds) <= report.optimise_seconds
    assert not table.training
    return table, report.loss


def test_fit_reaches_the_target():
    """Of one condition: KL falls to a small part of the uniform density's, and so does the loss."""
    targets = Targets.build(Plain(), Budget(resolution=16, pool=1), generator(2))
    mass = targets.mass[0].flatten().double()

    def kl(table: Table) -> float:
        log_mass = torch.log_softmax(table.logits.detach().double(), 0)
        return float((mass * (mass.log() - log_mass)).sum())

    table, loss = fit(targets, Budget(steps=300, conditions=16, directions=256))
    assert kl(table) < 0.05 * kl(Table())
    assert loss[-1] < loss[0] - 0.5 * kl(Table())


def test_equal_generators_equal_fits():
    """To the last bit; another seed gives another fit."""
    targets = few()
    tables = [fit(targets, BUDGET, seed)[0].logits for seed in (0, 0, 1)]
    assert torch.equal(tables[0], tables[1]) and not torch.equal(tables[0], tables[2])


def test_equal_generators_equal_methods():
    """All of a method's fit: initial weights, conditions and batches; not torch's global state."""
    states = []
    for seed in (0, 0, 1):
        torch.rand(seed + 3)
        before = torch.random.get_rng_state()
        method = ImprovedBaseline(width=8, layers=1)
        method.fit(Tilted(), BUDGET, generator(seed))
        assert torch.equal(torch.random.get_rng_state(), before)
        states.append(torch.cat([v.flatten() for v in method.state_dict().values()]))
    assert torch.equal(states[0], states[1]) and not torch.equal(states[0], states[2])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_loss_that_is_not_finite(bad):
    """Ends the fit and says where."""
    table = Table()
    with pytest.raises(FloatingPointError, match=rf"loss is {bad} at step 3"):
        calls = iter(range(100))
        minimise(
            table,
            lambda: table.logits.sum() * 0 + (bad if next(calls) == 3 else 1.0),
            few(),
            BUDGET,
        )


def test_nan_between_the_steps_that_are_looked_at():
    """Is seen at the next one at the latest, for the parameters are nan from then on."""
    table, calls = Table(), iter(range(1000))
    with pytest.raises(FloatingPointError, match="loss is nan"):
        minimise(
            table,
            lambda: table.logits.square().sum() * (math.nan if next(calls) == 101 else 1.0),
            few(),
            Budget(steps=500),
        )


def test_time_limit():
    """A fit past it raises with the limit and the step; one within it does not."""
    table = Table()

    def loss() -> Tensor:
        time.sleep(0.02)
        return table.logits.square().sum()

    with pytest.raises(BudgetExceeded, match=r"limit of 0.03 s at step \d of 30"):
        minimise(table, loss, few(), Budget(steps=30, max_seconds=0.03))
    minimise(table, loss, few(), Budget(steps=2, max_seconds=60))


def test_no_steps():
    """A budget of none leaves the module as it was built."""
    table, targets = Table(), few()
    report = minimise(table, lambda: table.logits.sum(), targets, Budget(steps=0))
    assert report.part_seconds == []
    assert (table.logits == 0).all() and report.steps == 0 and report.loss == []


def test_report_notes_black_conditions():
    """Which is a fact about the fit that a reader should see."""
    method = ImprovedBaseline(width=8, layers=1)
    report = method.fit(HalfBlack(), BUDGET, generator())
    assert "black conditions left out" in report.notes
    assert len(report.loss) == 30 and np.isfinite(report.loss).all()
