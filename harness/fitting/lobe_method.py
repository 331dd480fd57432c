"""Methods that are a mixture of lobes predicted by a network."""

from __future__ import annotations

import copy
from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.fitting.module_method import ModuleMethod
from harness.nets import lobes
from harness.nets.conditional import ConditionalMLP
from harness.nets.extremes import FAR, held


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

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: deviations and weights at the ends of their range.

        All weights are equal in ``sigma-to-...``: a lobe of no weight would hide its deviation.
        ``weights-to-0`` leaves the Lambertian lobe alone, ``uniform-to-0`` the first Gaussian.
        """
        if not isinstance(self.module, ConditionalMLP):
            return {}
        sigma, logits = self._roles()
        equal = dict.fromkeys(logits, 0.0)
        return {
            "sigma-to-0": self._held(equal | dict.fromkeys(sigma, -FAR)),
            "sigma-to-infinity": self._held(equal | dict.fromkeys(sigma, FAR)),
            "weights-to-0": self._held({k: FAR if i == 0 else -FAR for k, i in logits.items()}),
            "uniform-to-0": self._held({k: FAR if i == 1 else -FAR for k, i in logits.items()}),
        }

    def _held(self, outputs: dict[int, float]) -> dict[str, Tensor]:
        """The state with those outputs of the network at those values in every condition."""
        state, layer = self.state_dict(), f"mlp.layers.{len(self.module.mlp.layers) - 1}"
        for output, value in outputs.items():
            state = held(state, layer, slice(output, output + 1), value)
        return state

    @torch.no_grad()
    def _roles(self) -> tuple[list[int], dict[int, int]]:
        """Which outputs are log deviations, and which the logit of which weight.

        Found by moving one output at a time, so that a subclass says it only once, in
        :meth:`lobes`.
        """
        probe = copy.copy(self)
        probe.module = copy.deepcopy(self.module).cpu()
        last = probe.module.mlp.layers[-1]
        last.weight.zero_()
        last.bias.zero_()
        encoder = probe.module.encoder
        row = last.bias.new_zeros(1, encoder.n_address + encoder.n_features + 2)
        rest = probe.lobes(row)
        sigma, logits = [], {}
        for k in range(last.out_features):
            last.bias[k] = 1
            moved = probe.lobes(row)
            last.bias[k] = 0
            if not torch.equal(moved.log_sigma, rest.log_sigma):
                sigma.append(k)
            if not torch.equal(moved.log_weight, rest.log_weight):
                logits[k] = int((moved.log_weight - rest.log_weight).argmax())
        return sigma, logits
