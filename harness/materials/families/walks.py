"""A family whose reflectance is the expectation of a random walk."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.protocol.errors import Unsupported
from harness.materials.families.base import Family
from harness.materials.families.hashing import generator_at


class WalkFamily(Family):
    """f is known as a mean over random walks alone; two estimates of it are offered.

    :meth:`eval` averages ``walks`` of them, seeded by the bits of condition and direction. That
    makes it a function, whose error is a fixed one of zero mean: independent from one
    direction to the next, and gone from every integral over many directions. :meth:`noise` is
    its size. Weights f/pdf of any sampler contain it.

    :meth:`walk_columns` follows a walk from ``wi`` until it leaves: a direction in
    proportion to f and a weight whose mean is f's integral. The density of the direction
    has no closed form.
    """

    default_walks: ClassVar[int] = 16

    def __init__(
        self,
        name: str,
        fix: Mapping[str, float],
        identity: dict[str, Any],
        walks: int | None = None,
    ):
        super().__init__(name, fix, identity)
        self.walks = self.default_walks if walks is None else walks

    @abstractmethod
    def walk_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Any]:
        """``(x, y, weight)`` of one walk a row, the weight rgb.

        Where all light is lost, the weight is zero and the point lies off the disk.

        A function of the three uniforms ``u``: the first meeting takes them, and random
        numbers hashed from their bits are all that follow.
        """

    def generator(self, c: Columns, wo: Columns, seed: int) -> Any:
        """Random numbers for :meth:`eval_columns`: of parameters, free or fixed, wi, wo, seed."""
        return generator_at([*self.values(c).values(), *c[-2:], *wo], seed)

    def walk_sample(self, condition: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        r"""Directions [N, 2] and rgb weights [N, 3] of a walk per row of ``condition`` [N, C].

        .. math:: E[\text{weight}\,1_{\omega \in A}] = \int_A f\,dA,

        per area of the disk. ``u`` [N, 3] in [0, 1).
        """
        n = len(condition)
        if n == 0:
            return condition.new_empty(0, 2), condition.new_empty(0, 3)
        with torch.no_grad():
            x, y, weight = self.walk_columns(columns_of(condition), columns_of(u))
            packed = tensor_of(x, y, *weight, rows=n)
        return packed[:, :2], packed[:, 2:]

    def noise(self, condition: Tensor, wo: Tensor, repeats: int = 16) -> Tensor:
        """Standard deviation [N, 3] of :meth:`eval`, from evaluations of other seeds."""
        c, at = columns_of(condition), columns_of(wo)
        with torch.no_grad():
            values = [
                tensor_of(*self.eval_columns(c, at, seed), rows=len(condition))
                for seed in range(1, repeats + 1)
            ]
        return torch.stack(values).std(0)

    def why_no_gradient(self) -> str:
        """See :meth:`Material.why_no_gradient`."""
        return (
            f"material '{self.name}' gives no gradient of f: it is a mean over random walks, whose"
            " noise is another at every direction"
        )

    def target_gradient(self, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`Material.target_gradient`; there is none."""
        raise Unsupported(self.why_no_gradient())
