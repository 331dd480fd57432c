r"""The map that S steps of a solver make of a velocity field, and its exact density.

One step is :math:`T_k(x) = x + h\,u(x, t_k)` for Euler's method, h = 1 / S, t_k = k / S. What is
sampled is :math:`x_S = T_{S-1} \circ \dots \circ T_0 (x_0)`, so its density is

.. math:: p(x_S) = p_0(x_0) \prod_k \left|\det \frac{\partial T_k}{\partial x}(x_k)\right|^{-1}

with the very x_k and t_k of sampling: not that of the differential equation, from which the steps
stray, nor what steps of the same size backwards give (:func:`backward`), which are no inverse. A
density that is asked for at x_S has to invert each step: :func:`invert`, by Newton's method.

A step is one to one where all its determinants are positive (its velocity is bounded, so that it is
proper: Hadamard's theorem). :func:`forward` gives the least of them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from harness.nets.solvers import step
from harness.nets.velocity import Velocity

ROUNDS = 24
"""Of Newton's method, halvings of its steps among them."""
_COARSE = 1e-3
"""Error of a step's end, relative to the places, from which two steps of Newton's are exact."""


class Moved(NamedTuple):
    """Where a flow leads: ``x`` [B, D, 2]; ``log_det`` [B, D] of the whole map at its start;
    ``least`` [B, D] determinant of a step; ``jacobian`` [2, B, D, 2]: the whole map's derivatives
    by either coordinate."""

    x: Tensor
    log_det: Tensor
    least: Tensor
    jacobian: Tensor


class Origin(NamedTuple):
    """Where a point comes from: ``x`` [B, D, 2]; ``log_det`` [B, D] of the map from there on;
    ``found`` [B, D], whether Newton's method converged."""

    x: Tensor
    log_det: Tensor
    found: Tensor


def _add(x: Tensor, h: float, k: Tensor) -> Tensor:
    return x + h * k


def _dual(x: Tensor) -> Tensor:
    """``x`` with the identity as its derivatives."""
    unit = torch.eye(2, dtype=x.dtype, device=x.device)
    return torch.cat([x[None], unit[:, None, None].expand(2, *x.shape)])


def determinant(tangents: Tensor) -> Tensor:
    """Of derivatives [2, ..., 2] by x and by y."""
    (a, c), (b, d) = tangents[0].unbind(-1), tangents[1].unbind(-1)
    return a * d - b * c


def solve(tangents: Tensor, right: Tensor) -> Tensor:
    """The vector [..., 2] that the matrix of these derivatives takes to ``right``."""
    (a, c), (b, d) = tangents[0].unbind(-1), tangents[1].unbind(-1)
    x, y = right.unbind(-1)
    return torch.stack([d * x - b * y, a * y - c * x], -1) / (a * d - b * c)[..., None]


def apply(tangents: Tensor, vector: Tensor) -> Tensor:
    """The matrix of these derivatives times ``vector`` [..., 2]."""
    return tangents[0] * vector[..., :1] + tangents[1] * vector[..., 1:]


class DiscreteFlow:
    """S steps of a solver through a velocity field; ``shared`` is what the field made of a
    condition (:meth:`Velocity.shared`)."""

    def __init__(self, velocity: Velocity, steps: int, solver: str = "euler"):
        self.velocity, self.steps, self.solver = velocity, steps, solver

    def one(self, x: Tensor, k: int, shared: Tensor, back: bool = False) -> Tensor:
        """Step ``k`` from ``x`` [B, D, 2]; with ``back`` an explicit one back from its end."""
        h = 1 / self.steps

        def field(x: Tensor, t: float) -> Tensor:
            return self.velocity(x, t, shared)

        t, h = ((k + 1) * h, -h) if back else (k * h, h)
        return step(self.solver, field, _add, x, t, h)

    def one_dual(self, x: Tensor, k: int, shared: Tensor, back: bool = False) -> Tensor:
        """:meth:`one` with its derivatives beside it: [3, B, D, 2]."""
        h = 1 / self.steps

        def field(x: Tensor, t: float) -> Tensor:
            return self.velocity.push(x, t, shared)

        t, h = ((k + 1) * h, -h) if back else (k * h, h)
        return step(self.solver, field, _add, _dual(x), t, h)

    def endpoint(self, x: Tensor, shared: Tensor) -> Tensor:
        """Where ``x`` [B, D, 2] leads, without a density."""
        for k in range(self.steps):
            x = self.one(x, k, shared)
        return x

    def forward(self, x: Tensor, shared: Tensor) -> Moved:
        """Where ``x`` [B, D, 2] leads, and the density's determinants."""
        log_det = torch.zeros_like(x[..., 0])
        least = torch.full_like(log_det, torch.inf)
        whole = _dual(x)[1:]
        for k in range(self.steps):
            x, *tangents = self.one_dual(x, k, shared)
            along = torch.stack(tangents)
            det = determinant(along)
            log_det, least = log_det + det.abs().log(), torch.minimum(least, det)
            whole = torch.stack([apply(along, column) for column in whole])
        return Moved(x, log_det, least, whole)

    def backward(self, x: Tensor, shared: Tensor) -> Origin:
        """**Not** the inverse: explicit steps back from ``x``, as the published pdfs take them.

        Euler's step k goes from t_{k+1} to t_k with the velocity at its *end*, both in place and
        in time. Its density is that of no sampler.
        """
        log_det = torch.zeros_like(x[..., 0])
        for k in range(self.steps - 1, -1, -1):
            x, *tangents = self.one_dual(x, k, shared, back=True)
            log_det = log_det - determinant(torch.stack(tangents)).abs().log()
        return Origin(x, log_det, torch.ones_like(log_det, dtype=torch.bool))

    @torch.no_grad()
    def invert(self, x: Tensor, shared: Tensor) -> Origin:
        """The start of what ends in ``x`` [B, D, 2], by Newton's method, step after step."""
        log_det = torch.zeros_like(x[..., 0])
        found = torch.ones_like(log_det, dtype=torch.bool)
        for k in range(self.steps - 1, -1, -1):
            x, along, converged = self.invert_one(x, k, shared)
            log_det = log_det + determinant(along).abs().log()
            found = found & converged
        return Origin(x, log_det, found)

    @torch.no_grad()
    def invert_one(
        self, y: Tensor, k: int, shared: Tensor, rounds: int = ROUNDS, tolerance: float = 0.0
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The ``x`` of T_k(x) = ``y``, the step's derivatives there, and whether it was found.

        Begins where the explicit step back leads. A step of Newton's that does not come nearer is
        halved; as long as the determinant is not zero, a small enough one does.
        """
        tolerance = tolerance or 64 * torch.finfo(y.dtype).eps
        x = self.one(y, k, shared, back=True)
        out = self.one_dual(x, k, shared)
        scale = y.abs().amax(-1) + x.abs().amax(-1) + 1
        left = (out[0] - y).abs().amax(-1)
        move = solve(out[1:], y - out[0])
        for _ in range(rounds):
            # Most are there after one round: the others go on without them.
            rows = (left > tolerance * scale).nonzero(as_tuple=True)
            if not len(rows[0]):
                break
            trial, old, goal = x[rows] + move[rows], left[rows], y[rows]
            there = self.one_dual(trial[:, None], k, shared[rows[0]])[:, :, 0]
            away = (there[0] - goal).abs().amax(-1)
            better = away < old
            kept = torch.where(better[:, None], there, out[(slice(None), *rows)])
            newton = solve(kept[1:], goal - kept[0])
            move[rows] = torch.where(better[:, None], newton, move[rows] / 2)
            x[rows] = torch.where(better[:, None], trial, x[rows])
            left[rows] = torch.where(better, away, old)
            out[(slice(None), *rows)] = kept
        # A last step of Newton's costs nothing: it takes the rest of the error off the place.
        x = x + solve(out[1:], y - out[0])
        return x, out[1:], left <= 16 * tolerance * scale

    def origin(self, x: Tensor, shared: Tensor, rounds: int) -> Origin:
        """:meth:`invert` with gradients, for fits.

        A step's inverse is differentiated where it is found, by the implicit function theorem: one
        more step of Newton's from there, its matrix held, has the derivatives that the inverse has,
        and squares what is left of the error: ``_COARSE`` is near enough to begin with.
        """
        log_det = torch.zeros_like(x[..., 0])
        found = torch.ones_like(log_det, dtype=torch.bool)
        for k in range(self.steps - 1, -1, -1):
            at, along, converged = self.invert_one(x, k, shared, rounds, _COARSE)
            x = at - solve(along, self.one(at, k, shared) - x)
            det = determinant(self.one_dual(x, k, shared)[1:])
            # Where nothing was found there is nothing to learn from, and no logarithm to take.
            found = found & converged & (det > 0)
            log_det = log_det + torch.where(found, det, 1).log()
        return Origin(x, log_det, found)
