"""Methods that are a normalizing flow of the projected disk."""

from __future__ import annotations

import copy
from abc import abstractmethod

import torch
from torch import Tensor, nn

from harness.core.columns.method import ColumnMethod
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport
from harness.fitting.steady import ROWS, SteadyMethod, moved
from harness.nets import defensive, lobes
from harness.nets.coupling import uniforms_of_normal


class FlowMethod(SteadyMethod, ColumnMethod):
    r"""A flow :math:`z = T(\omega)` of a base density, and a uniform share beside it.

    .. math:: p(\omega) = (1 - \varepsilon)\,N(T(\omega))
              \left|\frac{\partial T}{\partial \omega}\right|
              + \frac{\varepsilon}{\pi}\,[|\omega| < 1]

    The base N is standard normal unless a subclass says otherwise.
    A subclass gives the map both ways in torch (:meth:`to_base`, :meth:`from_base`) and the
    sampler over columns. ``uniform`` is :math:`\varepsilon`, picked by the third uniform.

    The density belongs to the samples only as long as the rounding of :math:`\omega` to single
    precision leaves its base point where it is. Couplings multiply: a steep map of x, seen by a
    network that is steep in x, moves y by a million times the rounding, and no arithmetic
    inside can mend what the rounded direction has lost. No bound on a layer tells such a map
    from a useful one (diverged weights have seven times the spectral norms of a fit and up to
    a hundred thousand times its movements), so the movement itself is measured, once for each
    state: :meth:`fit` and :meth:`load_state_dict` refuse those that move.
    """

    uniforms = 3
    origin = "its base point"
    uniform: float

    @abstractmethod
    def to_base(self, net: nn.Module, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """T: z [B, D, 2] of ``wo`` [B, D, 2], and log |dz / dwo| [B, D], by the module ``net``."""

    @abstractmethod
    def from_base(self, net: nn.Module, condition: Tensor, z: Tensor) -> Tensor:
        """The inverse of T: ``wo`` [B, D, 2] of ``z`` [B, D, 2]."""

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D]."""
        z, log_slope = self.to_base(self.module, condition, wo)
        flow = self.log_base(z) + log_slope
        raw = self.share_logit(self.module, condition)
        if raw is None:
            return defensive.log_mixed(flow, wo, self.uniform)
        return defensive.log_mixed_logit(flow, wo, raw, self.uniform)

    def log_base(self, z: Tensor) -> Tensor:
        """Log density [...] of the base at ``z`` [..., 2]: standard normal."""
        return -0.5 * z.square().sum(-1) - lobes.LOG_2PI

    def base_uniforms(self, z: Tensor) -> Tensor:
        """The uniforms [..., 2] that are sampled as ``z`` [..., 2]."""
        return uniforms_of_normal(z)

    def base_points(self, rows: int, generator: torch.Generator) -> Tensor:
        """Points [rows, 1, 2] of the base, in double precision."""
        return torch.randn(rows, 1, 2, generator=generator, dtype=torch.float64)

    def share_logit(self, net: nn.Module, condition: Tensor) -> Tensor | None:
        """Logit [B, 1] of what a condition adds to the uniform share; None where it is fixed."""
        return None

    @torch.no_grad()
    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.inverse`: the uniforms [N, 3] of the flow's branch, in double."""
        net = copy.deepcopy(self.module).double()
        z, _ = self.to_base(net, condition.double(), wo[:, None].double())
        u = self.base_uniforms(z[:, 0])
        share = torch.full_like(u[:, :1], self.uniform)
        raw = self.share_logit(net, condition.double())
        if raw is not None:
            share = self.uniform + (1 - self.uniform) * torch.sigmoid(raw)
        # The middle of what is not the uniform share's.
        return torch.cat([u, (1 + share) / 2], 1)

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`Method.fit`.

        Raises:
            StateRefused: the fit ended where single precision cannot follow (:meth:`unsteady`).
        """
        report = super().fit(material, budget, generator)
        self.refuse_unsteady()
        return report

    @torch.no_grad()
    def unsteady(self) -> float:
        """Share of samples whose base point moves more than ``STEADY`` when wo is rounded.

        Of ``ROWS`` samples, always the same ones, each in a condition of its own. In double
        precision, so that nothing but the map itself moves them. Those off the disk, which are
        thrown away, do not count.
        """
        if self.material is None:
            raise RuntimeError(f"{self.name}: used before fit or bind")
        net = copy.deepcopy(self.module).double()
        generator = torch.Generator().manual_seed(0)
        device = next(net.parameters()).device
        condition = self.material.conditions(ROWS, generator, str(device)).double()
        z = self.base_points(ROWS, generator).to(device)
        wo = self.from_base(net, condition, z)

        def origin(at: Tensor) -> Tensor:
            return self.to_base(net, condition, at[:, None])[0][:, 0]

        far = moved(origin, wo[:, 0], 1.0)
        return float((far & self.followed(wo[:, 0])).double().mean())

    def followed(self, wo: Tensor) -> Tensor:
        """Samples [N] whose base point single precision is expected to find again, by ``wo``."""
        return inside_disk(wo)
