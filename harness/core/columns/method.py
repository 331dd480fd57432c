"""A method whose sampler is one Dr.Jit kernel."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.protocol.method import DiskSample, Method, WeightedSample


class ColumnMethod(Method):
    """A :class:`Method` written over columns: structure of arrays instead of rows.

    A subclass gives :meth:`sample_columns` and :meth:`pdf_columns`. The tensors of the
    protocol are bridged to them, and a renderer that already has columns calls them
    directly, without leaving Dr.Jit.
    """

    in_one_kernel: ClassVar[bool] = False
    """Whether it runs well as part of a renderer's own kernel: without a network, whose
    activations would go through the stack there."""

    @abstractmethod
    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """Directions and density ``(x, y, pdf)`` for condition columns and three uniforms."""

    def sample_weighted_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float, Any]:
        """``(x, y, pdf, [r, g, b])``: see :meth:`Method.sample_weighted`.

        Has to be given where :attr:`Method.exact_pdf` is false.
        """
        raise NotImplementedError(f"{self.name}: an approximate pdf without weights")

    @abstractmethod
    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """Density per disk area at ``wo = [x, y]``."""

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        n = len(condition)
        if n == 0:
            return DiskSample(condition.new_empty(0, 2), condition.new_empty(0))
        with torch.no_grad():
            x, y, pdf = self.sample_columns(columns_of(condition), columns_of(u))
            packed = tensor_of(x, y, pdf, rows=n, by_columns=True)
        return DiskSample(packed[:, :2], packed[:, 2])

    def sample_weighted(self, condition: Tensor, u: Tensor) -> WeightedSample:
        """See :meth:`Method.sample_weighted`."""
        n = len(condition)
        if self.exact_pdf or n == 0:
            return super().sample_weighted(condition, u)
        with torch.no_grad():
            x, y, pdf, weight = self.sample_weighted_columns(columns_of(condition), columns_of(u))
            packed = tensor_of(x, y, pdf, *weight, rows=n)
        return WeightedSample(packed[:, :2], packed[:, 2], packed[:, 3:])

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        n = len(condition)
        if n == 0:
            return condition.new_empty(0)
        with torch.no_grad():
            return tensor_of(self.pdf_columns(columns_of(condition), columns_of(wo)), rows=n)
