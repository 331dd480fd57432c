"""Tabulated targets, draws from them, and the training loop."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from harness._methods.improved_baseline import ImprovedBaseline
from harness.core.protocol.disk import disk_to_square, inside_disk
from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.method import Budget
from harness.fitting import train, until
from harness.fitting.targets import Targets, cells, tabulate
from harness.fitting.train import minimise
from harness.fitting.until import Validation, fit_until
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


def few() -> Targets:
    """Two conditions, so that each is drawn often."""
    return Targets.build(Tilted(), Budget(pool=2), generator(5))


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
    targets = Targets.build(Plain(), Budget(pool=1), generator(2))
    mass = tabulate(Plain(), targets.condition, 64)[0].double()
    mass = mass.view(16, 4, 16, 4).sum((1, 3)).flatten() / mass.sum()

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


# --- budgets of another kind -------------------------------------------------------------


def test_budget_of_seconds(monkeypatch):
    """Ends in time with what it has, however many steps the budget names, its rate down to none.

    What the targets took counts.
    """
    table, clock, moves = Table(), [5.0], []
    monkeypatch.setattr(train, "time", SimpleNamespace(perf_counter=lambda: clock[0]))

    def loss() -> Tensor:
        clock[0] += 0.0101
        moves.append(table.logits.detach().clone())
        return table.logits.sum()

    budget = Budget(steps=7, seconds=1.0)
    report = minimise(table, loss, few(), budget)
    assert report.steps == len(moves) == 100 and 1 <= report.optimise_seconds < 1.02
    assert report.part_seconds == [] and len(report.loss) == 11
    # Of a constant gradient, Adam moves by the rate.
    rates = torch.stack(moves).diff(dim=0).abs().amax(1)
    assert rates[5] > 0.9 * rates.max() and rates[-1] < 0.01 * rates.max()
    assert budget.less(0.4, 2).seconds == pytest.approx(0.3)
    with pytest.raises(BudgetExceeded, match=r"took 1.5 s of the 1 s"):
        budget.less(1.5)
    assert BUDGET.less(3.0) is BUDGET


def test_fit_until_it_is_converged():
    """Steps are doubled until KL on conditions held out moves by less; the last fit is kept."""
    budget = Budget(steps=10, conditions=32, directions=16, pool=64, until=0.2)
    method, report = fit_until(lambda: ImprovedBaseline(8, 1), Tilted(), budget, generator())
    steps, kl = zip(*report.validation, strict=True)
    assert steps == tuple(10 << i for i in range(len(steps))) and report.steps == steps[-1]
    moves = [abs(a - b) / b for a, b in zip(kl, kl[1:], strict=False)]
    assert moves[-1] <= 0.2 and all(move > 0.2 for move in moves[:-1])
    assert Validation(Tilted()).kl(method) == kl[-1]
    plain = ImprovedBaseline(8, 1)
    plain.fit(Tilted(), Budget(**{**vars(budget), "steps": steps[-1], "until": None}), generator())
    for name, value in plain.state_dict().items():
        assert torch.equal(value, method.state_dict()[name])


def test_fit_that_does_not_converge(monkeypatch):
    """Says by how much KL still moves."""
    monkeypatch.setattr(until, "DOUBLINGS", 1)
    budget = Budget(steps=5, conditions=16, directions=8, pool=64, until=1e-6)
    with pytest.raises(BudgetExceeded, match=r"moves by [\d.]+% from 5 to 10 steps"):
        fit_until(lambda: ImprovedBaseline(8, 1), Tilted(), budget, generator())
