"""Networks and inputs for tests of flows."""

from __future__ import annotations

import torch

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material

BELOW_ONE = 1 - 2**-24


class Plain(Material):
    name, n_features = "plain", 8

    def eval(self, condition, wo):
        return inside_disk(wo)[:, None].float().expand(-1, 3)

    def places(self, uv):
        return torch.sin(uv @ torch.arange(16.0).view(2, 8))

    def identity(self):
        return {"name": self.name}


def inputs(n: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    return Plain().conditions(n, g), torch.rand(n, 3, generator=g)
