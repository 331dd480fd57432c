"""Methods that are a mixture of lobes predicted by a network."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from torch import Tensor

from harness.columns import ColumnMethod, Columns, Float
from harness.fitting.module_method import ModuleMethod
from harness.nets import lobes


class LobeMethod(ModuleMethod, ColumnMethod):
    """A mixture of one Lambertian and some Gaussian lobes, its parameters from a module.

    Fitted by maximum likelihood. A subclass reads the module's outputs as lobes, once in
    torch and once over columns. Uses three uniforms.
    """

    learning_rate: ClassVar[float] = 5e-3

    @abstractmethod
    def lobes(self, condition: Tensor) -> lobes.Lobes:
        """Mixture parameters of shape [B] for ``condition`` [B, C]."""

    @abstractmethod
    def lobes_columns(self, c: Columns) -> lobes.ColumnLobes:
        """The same over columns."""

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D]."""
        return lobes.log_prob(self.lobes(condition), wo)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        return lobes.sample_columns(self.lobes_columns(c), u)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        return lobes.pdf_columns(self.lobes_columns(c), wo)
