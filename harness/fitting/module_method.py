"""A method that is one fitted network module."""

from __future__ import annotations

import copy
from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn

from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Method
from harness.fitting.precision import round_weights, shortened
from harness.fitting.targets import Targets
from harness.fitting.train import minimise
from harness.nets.encoding import ConditionEncoder


class ModuleMethod(Method):
    """A method whose state is one ``nn.Module``.

    A subclass says how to build the module for a material (:meth:`build`) and gives a
    loss; by default the negative log likelihood of directions drawn from p*, whose
    minimiser has the least KL(p* || p), through :meth:`log_prob`.
    """

    learning_rate: ClassVar[float] = 5e-4
    weight_decay: ClassVar[float] = 1e-5

    precision: str = "float32"
    """``bfloat16`` rounds the weights after fitting and stores them in half the bytes."""

    module: nn.Module

    @abstractmethod
    def build(self, material: Material) -> nn.Module:
        """A fresh module for the material's condition layout."""

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Differentiable log density [B, D] at ``condition`` [B, C], ``wo`` [B, D, 2]."""
        raise NotImplementedError(f"{type(self).__name__} gives neither log_prob nor loss")

    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.reference_pdf`: :meth:`log_prob` with the module in doubles."""
        plain = copy.copy(self)
        plain.module = copy.deepcopy(self.module).double()
        with torch.no_grad():
            return plain.log_prob(condition.double(), wo.double()[:, None])[:, 0].exp()

    def loss(self, targets: Targets, budget: Budget, generator: torch.Generator) -> Tensor:
        """The quantity to minimise, on one batch."""
        condition, wo = targets.batch(budget.conditions, budget.directions, generator)
        return -self.log_prob(condition, wo).mean()

    def bind(self, material: Material) -> None:
        """See :meth:`Method.bind`; makes the untrained module on first use."""
        if self.material is not material:
            self.material = material
            self.module = self.build(material).eval()
            round_weights(self.module, self.precision)

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`Method.fit`."""
        self.material = material
        seed = int(torch.randint(1 << 62, (), generator=generator))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.module = self.build(material)
        targets = Targets.build(material, budget, generator)
        self.prepare(targets)
        report = minimise(
            self.module,
            lambda: self.loss(targets, budget, generator),
            targets,
            budget.less(targets.seconds),
            learning_rate=self.learning_rate,
            weight_decay=self.weight_decay,
        )
        round_weights(self.module, self.precision)
        return report

    def prepare(self, targets: Targets) -> None:
        """Look at the targets once before fitting; by default standardises every encoder."""
        for part in self.module.modules():
            if isinstance(part, ConditionEncoder):
                part.standardise(targets.condition)

    def state_dict(self) -> dict[str, Tensor]:
        """See :meth:`Method.state_dict`."""
        return shortened(self.module, self.precision)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """See :meth:`Method.load_state_dict`; ``bind`` first. Moves to the state's device."""
        self.module.to(next(iter(state.values())).device)
        self.module.load_state_dict(state)
        round_weights(self.module, self.precision)
        self.module.eval()
