"""A material whose reflectance is one Dr.Jit kernel."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.protocol.disk import REC709
from harness.core.protocol.material import Material


class ColumnMaterial(Material):
    """A :class:`Material` written over columns: structure of arrays instead of rows.

    A subclass gives :meth:`eval_columns`; the tensors of the protocol are bridged to it. The
    target is fused with it, for it is evaluated by the hundred million.
    """

    @abstractmethod
    def eval_columns(self, c: Columns, wo: Columns) -> Any:
        """BSDF without cosine, three columns, at condition columns and ``wo = [x, y]``."""

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        n = len(condition)
        if n == 0:
            return condition.new_empty(0, 3)
        with torch.no_grad():
            return tensor_of(*self.eval_columns(columns_of(condition), columns_of(wo)), rows=n)

    def target(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.target`."""
        n = len(condition)
        if n == 0:
            return condition.new_empty(0)
        with torch.no_grad():
            f = self.eval_columns(columns_of(condition), columns_of(wo))
            return tensor_of(_target(f), rows=n)

    def target_grid(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.target_grid`; rows and directions are gathered in the kernel."""
        n, m = len(condition), wo.shape[1]
        if n * m == 0:
            return condition.new_empty(n, m)
        with torch.no_grad():
            c, points = columns_of(condition), columns_of(wo.reshape(-1, 2))
            array = type(c[0])
            index = dr.arange(dr.uint32_array_t(array), n * m)
            row, point = index // m, index if len(wo) == n else index % m
            wide = [dr.gather(array, column, row) for column in c]
            f = self.eval_columns(wide, [dr.gather(array, v, point) for v in points])
            return tensor_of(_target(f), rows=n * m).view(n, m)

    def why_no_gradient(self) -> str:
        """See :meth:`Material.why_no_gradient`: what is written in Dr.Jit has a derivative."""
        return ""

    def target_gradient(self, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`Material.target_gradient`; by Dr.Jit's reverse mode, one kernel."""
        n = len(condition)
        if n == 0:
            return condition.new_empty(0), condition.new_empty(0, 2)
        with torch.inference_mode():
            # Arrays of their own: a derivative is kept beside the array that it is of.
            c, at = columns_of(condition), [type(v)(v) for v in columns_of(wo)]
            dr.enable_grad(at)
            found = _target(self.eval_columns(c, at))
            dr.backward(found)
            packed = tensor_of(dr.detach(found), *(dr.grad(v) for v in at), rows=n)
        return packed[:, 0].clone(), packed[:, 1:].clone()


def _target(rgb: Any) -> Float:
    return dr.abs(REC709[0] * rgb[0] + REC709[1] * rgb[1] + REC709[2] * rgb[2])
