"""The tabulated ceiling: its density, black rows, and what it keeps between calls."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from harness._methods.tabulated import Tabulated
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.fitting.targets import cells, tabulate
from tests.materials import HalfBlack, Plain, Tilted


class Counting(Tilted):
    """Counts the rows it is evaluated for."""

    rows = 0

    def target(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.target`."""
        self.rows += len(wo)
        return super().target(condition, wo)


def bound(material: Material, **parameters) -> Tabulated:
    """The method for a material."""
    method = Tabulated(**parameters)
    method.bind(material)
    return method


def test_default_is_the_papers_size():
    """2048 x 2048 cells."""
    assert Tabulated().resolution == 2048


@pytest.mark.parametrize("defensive", [0.0, 2**-7, 0.5])
def test_density_is_the_target(defensive):
    """In each cell, the normalised target at the centre and a share of the uniform disk."""
    material, n = Tilted(), 32
    condition = material.conditions(5, torch.Generator().manual_seed(0))
    table = tabulate(material, condition, n).flatten(1)
    expected = (1 - defensive) * table / table.sum(1, keepdim=True) + defensive / n**2
    pdf = bound(material, resolution=n, defensive=defensive).pdf(
        condition.repeat_interleave(n * n, 0), cells(n).repeat(5, 1)
    )
    torch.testing.assert_close(pdf.view(5, -1) * math.pi / n**2, expected)


def test_black_rows_are_uniform():
    """A row without any reflection is sampled uniformly, and says so."""
    method = bound(HalfBlack(), resolution=8)
    n = 4000
    condition = torch.tensor([-0.5, 0.2]).expand(n, 2)
    wo, pdf = method.sample(condition, torch.rand(n, 3))
    assert inside_disk(wo).all()
    torch.testing.assert_close(pdf, torch.full((n,), 1 / math.pi))
    torch.testing.assert_close(method.pdf(condition, wo), pdf)
    assert wo.mean(0).abs().max() < 0.05


def test_defensive_share_covers_what_the_table_misses():
    """Zero cells are reached with the stated share, and not at all without it."""
    row = torch.tensor([0.5, 0.2])
    u = torch.rand(20000, 3, generator=torch.Generator().manual_seed(1))
    for defensive in (0.0, 0.25):
        method = bound(HalfBlack(), resolution=8, defensive=defensive)
        wo, pdf = method.sample(row.expand(len(u), 2), u)
        # Centres just off the diagonals: the black cells are those left of the axis.
        share = (wo[:, 0] < -1e-6).float().mean()
        assert abs(share - defensive / 2) < 0.01
        assert (pdf[wo[:, 0] > 1e-6] > 0).all()


def test_pdf_after_sample_does_not_tabulate_again():
    """The sums of one batch are kept, and only for the same conditions and material."""
    material = Counting()
    method = bound(material, resolution=16)
    generator = torch.Generator().manual_seed(2)
    first, second = (material.conditions(10, generator) for _ in range(2))
    u = torch.rand(10, 3, generator=generator)
    wo = method.sample(first, u).wo
    material.rows = 0
    kept = method.pdf(first.clone(), wo)
    assert material.rows == 10
    fresh = method.pdf(second, wo)
    assert material.rows == 20 + 10 * 16**2
    torch.testing.assert_close(fresh, bound(Tilted(), resolution=16).pdf(second, wo))
    torch.testing.assert_close(kept, bound(Tilted(), resolution=16).pdf(first, wo))
    plain = Plain()
    method.bind(plain)
    at = second[:, 2:]
    torch.testing.assert_close(method.pdf(at, wo), bound(plain, resolution=16).pdf(at, wo))


def test_caller_may_write_to_the_condition_between_calls():
    """What is kept is a copy."""
    material = Tilted()
    method = bound(material, resolution=16)
    condition = material.conditions(10, torch.Generator().manual_seed(3))
    wo = method.sample(condition, torch.rand(10, 3)).wo
    condition[:, 0] = 0.9
    torch.testing.assert_close(
        method.pdf(condition, wo), bound(material, resolution=16).pdf(condition, wo)
    )


@pytest.mark.parametrize(
    "parameters", [{"resolution": 0}, {"defensive": 1.0}, {"defensive": -0.1}], ids=str
)
def test_refused_parameters(parameters):
    """One line that names the parameter."""
    with pytest.raises(InputError, match=next(iter(parameters))):
        Tabulated(**parameters)
