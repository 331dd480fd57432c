"""A material with a method that is fitted to it: what a script samples, renders and plugs in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from harness.api.subjects import MaterialLike, MethodLike, material, method, ready
from harness.core.protocol.errors import InputError, Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, FitReport, Method
from harness.suite.trials import FIT, stream_seed

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass(frozen=True)
class Sampler:
    """``method``, fitted to ``material``. Made by ``harness.fit`` and ``harness.load_sampler``.

    Directions are points (x, y) of the projected disk; densities are per unit of its area. Per
    solid angle: times cos(theta), with ``cos^2 = 1 - x^2 - y^2``. Results are ordinary tensors
    without gradient on ``device``. ``report`` says what the fit took; None if it was stored.
    """

    material: Material
    method: Method
    device: str = "cpu"
    report: FitReport | None = None

    def conditions(self, n: int, seed: int = 0) -> Tensor:
        """``n`` random conditions [n, C]: places of the material and given directions.

        The last two columns are ``wi.xy``, uniform on the disk.
        """
        generator = torch.Generator().manual_seed(seed)
        with torch.no_grad():
            return self.material.conditions(n, generator, self.device).clone()

    def sample(self, condition: Tensor, u: Tensor | None = None, seed: int = 0) -> DiskSample:
        """Directions ``wo`` [N, 2] and their densities ``pdf`` [N], one per row of ``condition``.

        ``u`` [N, 3] are uniforms in [0, 1); without them they are drawn with ``seed``. A direction
        off the unit disk is an invalid sample, whose estimate is zero.
        """
        condition = self._row(condition, "condition", self.material.n_condition)
        if u is None:
            generator = torch.Generator().manual_seed(seed)
            u = torch.rand(len(condition), 3, generator=generator)
        u = self._row(u, "u", 3, len(condition))
        with torch.no_grad():
            return self.method.sample(condition, u)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Density [N] of :meth:`sample` at ``wo`` [N, 2], per disk area."""
        condition, wo = self._pair(condition, wo)
        with torch.no_grad():
            return self.method.pdf(condition, wo)

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """BSDF [N, 3] at ``wo`` [N, 2], per steradian, without cosine."""
        condition, wo = self._pair(condition, wo)
        with torch.no_grad():
            return self.method.eval(condition, wo)

    def bsdf(self) -> mi.BSDF:
        """The pair as a Mitsuba BSDF, to stand under ``bsdf`` in ``mitsuba.load_dict``.

        Where a part of it runs in PyTorch, Dr.Jit cannot trace it into a symbolic call: its flags
        ``SymbolicCalls`` and ``SymbolicLoops`` are then set to False in this thread, for good. A
        render with them on, in another thread perhaps, fails and says so. A pair that runs in
        Dr.Jit alone renders either way, and several times faster inside
        ``harness.evaluated_mode()``.
        """
        ready(self.device)
        import drjit as dr

        from harness.rendering.plugin import SampledBSDF

        made = SampledBSDF(self.material, self.method)
        evaluated = made.nested is not None or made.eval_in_columns
        if not (made.in_columns and evaluated and not made.own_eval):
            for flag in (dr.JitFlag.SymbolicCalls, dr.JitFlag.SymbolicLoops):
                dr.set_flag(flag, False)
        return made

    def _pair(self, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        condition = self._row(condition, "condition", self.material.n_condition)
        return condition, self._row(wo, "wo", 2, len(condition))

    def _row(self, given: Tensor, what: str, width: int, rows: int | None = None) -> Tensor:
        """``given`` in single precision where the sampler is; its shape must be right."""
        found = torch.as_tensor(given, dtype=torch.float32, device=self.device)
        if found.ndim != 2 or found.shape[1] != width or rows not in (None, len(found)):
            shape = f"[{'N' if rows is None else rows}, {width}]"
            raise InputError(f"{what}: expected the shape {shape}, got {list(found.shape)}")
        return found


def fit(
    by: MethodLike,
    to: MaterialLike,
    budget: Budget | None = None,
    seed: int = 0,
    **parameters: Any,
) -> Sampler:
    """Fit a method to a material.

    ``by`` is a name (``harness list methods``), ``file.py:Class``, a subclass of
    ``harness.Method`` or an object of one; ``parameters`` are its constructor's. ``to`` is a
    material as ``harness.material`` takes it. ``budget`` says how much the fit may spend and on
    which device; with the budget and ``seed`` of a suite's trial the fit is that trial's.

    Raises:
        InputError: a method or material that is refused.
        Unsupported: the method cannot sample the material.
        BudgetExceeded: the fit took longer than ``budget.max_seconds``.
    """
    # Without a device that is named, that of the variant of Mitsuba that is set.
    budget = budget or Budget(device=ready(None))
    ready(budget.device)
    target, made = material(to), method(by, **parameters)
    supported, reason = made.supports(target)
    if not supported:
        raise Unsupported(reason or f"{made.name} does not support {target.name}")
    generator = torch.Generator().manual_seed(stream_seed(FIT, seed))
    report = made.fit(target, budget, generator)
    if not isinstance(report, FitReport):
        kind = type(report).__name__
        raise InputError(f"{made.name}: fit returned a {kind}, expected a harness.FitReport")
    if made.material is None:  # a fit of one's own need not say it
        made.bind(target)
    return Sampler(target, made, budget.device, report)
