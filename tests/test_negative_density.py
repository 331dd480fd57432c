"""A density that is negative or infinite in a few rows of large batches never counts as fine."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from harness.core.protocol.method import DiskSample
from harness.measures import adapter_smoke_test
from harness.measures.densities import checked_density
from harness.mitsuba_runtime import variant
from tests.measure_subjects import Still, Uneven, job
from tests.measuring import run

variant.use("cpu")

LARGE, ONE_IN = 1000, 997
MEASURES = {
    "equal-spp": {"resolution": 8, "spp": 64, "batches": 6, "reference_spp": 64, "longest": 1},
    "equal-time": {"resolution": 48, "rounds": 6, "deadline": 0.01, "warm_up": 0.0},
    "convergence": {"resolution": 8, "levels": 6, "repeats": 2, "reference_spp": 64},
    "pdf": {"conditions": 16, "resolution": 16},
    "sample-weights": {"conditions": 8, "samples": 256},
    "slices": {"count": 2, "grid": 64},
}


class InLargeBatches(Uneven):
    """Right in small batches; one row in ``ONE_IN`` of larger ones has a density that is none."""

    name = "in-large-batches"

    def __init__(self, bad: float):
        super().__init__(1.0)
        self.bad = bad

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, pdf = super().sample(condition, u)
        return DiskSample(wo, pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        found = super().pdf(condition, wo)
        if len(found) > LARGE:
            found[ONE_IN // 2 :: ONE_IN] = self.bad
        return found


@pytest.mark.parametrize("bad", [-0.25, math.inf, math.nan])
@pytest.mark.parametrize("name", MEASURES)
def test_no_measure_takes_it_for_a_density(name: str, bad: float):
    method = InLargeBatches(bad)
    material = Still()
    adapter_smoke_test.smoke_test(method, material, torch.Generator().manual_seed(0), "cpu")
    jobs = [job(name, method, material, baseline=True, **MEASURES[name])]
    with pytest.raises(FloatingPointError, match=r"in-large-batches.* (not finite|no number)"):
        run(name, jobs)


def test_a_density_is_finite_and_not_negative():
    good = torch.tensor([0.0, 1e-30, 3.0, torch.finfo(torch.float32).max])
    assert checked_density(good, Uneven()) is good
    for bad in (-1e-30, math.inf, -math.inf, math.nan):
        with pytest.raises(FloatingPointError, match="uneven: pdf is negative or not finite in 1"):
            checked_density(torch.tensor([1.0, bad]), Uneven())
