"""Reparameterisation with a guarantee: one step, one preimage, an exact density."""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError, Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Knob
from harness.fitting.drawn import Drawn
from harness.fitting.flow_method import FlowMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.fitting.reverse import LEAST, stratified_uniforms, target_of
from harness.fitting.targets import Targets
from harness.nets import defensive, lobes, plane, spline
from harness.nets.extremes import FAR, held
from harness.nets.triangular import Conditioners

BOUND = 6.0
"""Splines bend logistic points up to this size, 99.5 % of them, and leave the others."""
OBJECTIVES = ("forward", "both")
FORMS = {"objective": OBJECTIVES}


class Reparameterised(FlowMethod):
    r"""One network for each coordinate, one step, **a bijection by construction**.

    Wu et al. (2025) map normal points to directions by a free network: cheap, and nothing says
    that every direction is reached, or reached once (``reparameterised-published``). Here the map
    of uniforms :math:`(u_1, u_2)`, by way of their logistic points :math:`z_i = \log\frac{u_i}{1 -
    u_i}`, is triangular with increasing entries:

    .. math:: a = m(c) + e^{s(c)}\,S_c(z_1), \quad
              b = m'(c, x) + e^{s'(c, x)}\,S'_{c, x}(z_2), \quad
              x = \tanh\tfrac a2, \quad y = \sqrt{1 - x^2}\,\tanh\tfrac b2

    S and S' are the inverses of rational-quadratic splines of ``bins`` bins on [-6, 6]
    (:mod:`harness.nets.spline`), the identity beyond. Two small networks give the numbers
    (:mod:`harness.nets.triangular`): one of the condition c; one of c, x and the rank of x,
    :math:`2 u_1 - 1`, which is x in the scale of its own lobe.

    **It is a bijection of the open square onto the open disk**, for any weights:

    1. u to z is one of (0, 1)² onto the plane, and (a, b) to (x, y) one of the plane onto the
       open disk (:mod:`harness.nets.plane`).
    2. For every c the map of z1 to a is an increasing bijection of the line: the spline is
       one of [-6, 6] onto itself, whatever its numbers, and is continued by the identity; a
       positive scale and a shift keep that. Given x, so is the map of z2 to b.
    3. A direction therefore has exactly one (a, b); a has exactly one z1, and with it x is known;
       b has exactly one z2. The Jacobian is triangular, its determinant the product of two
       positive slopes: nothing folds, and the degree is one.

    So the density is exact, of any direction and without search (the published form would need
    Newton's method, and a proof that there is one preimage):

    .. math:: q(\omega) = u_1 (1 - u_1)\,u_2 (1 - u_2)\,
              \frac{S_c^{-1\prime}\,S_{c,x}'^{-1\prime}}{e^{s + s'}}\,
              \frac{4}{\sqrt{1 - x^2}\,(1 - x^2 - y^2)}, \qquad
              p = (1 - \varepsilon)\,q + \frac{\varepsilon}{\pi}

    The weight is f / p. A share :math:`\varepsilon` of the samples, ``uniform`` or more as the
    first network says for the condition, is uniform on the disk: the Lambertian lobe, and the bound
    :math:`\pi f / \varepsilon` on every weight. No sample is invalid, but where the rim is nearer
    than rounding.

    **What the guarantee costs.** In variance: a triangular map bends x before y, so a lobe that
    lies aslant has to be learned as a y that follows x. In time nothing: its determinant needs two
    slopes where that of the free map needs two more passes of its network.

    ``objective``: ``forward`` maximises the likelihood of directions drawn from the tables of p*
    (:mod:`harness.fitting.drawn`), which cannot drop a mode; ``both`` adds the reverse KL of the
    map's own samples (:mod:`harness.fitting.reverse`), which knows f finer than a table does and
    needs its gradient.

    Uses three uniforms. The second network runs once, at the rounded x, so that the density is
    bit for bit the one :meth:`pdf` gives.

    Raises:
        Unsupported: ``both``, and the material gives no gradient.
        StateRefused: single precision cannot follow the state (:meth:`FlowMethod.unsteady`).
    """

    name = "reparameterised"
    learning_rate = 1e-2

    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("bins", (3, 5, 10, 20), "bins of each spline"),
        Knob("width", (8, 16, 20, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers of the second network"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self,
        width: int = 20,
        layers: int = 2,
        bins: int = 5,
        uniform: float = 0.01,
        objective: str = "forward",
        precision: str = "float32",
    ):
        if not 2 <= bins < 500:
            raise InputError(f"{self.name}: bins is {bins}; expected 2 to 499")
        if min(width, layers) < 1:
            raise InputError(
                f"{self.name}: expected at least one of width and layers, not {width} and {layers}"
            )
        if objective not in OBJECTIVES:
            raise InputError(
                f"{self.name}: objective is '{objective}'; expected 'forward' or 'both'"
            )
        self.width, self.layers, self.bins = width, layers, bins
        self.uniform = defensive.checked_share(uniform, self.name)
        self.objective = objective
        self.precision = checked_precision(precision, self.name)
        self._drawn: Drawn | None = None

    def supports(self, material: Material) -> tuple[bool, str]:
        """Any material; for the objective ``both``, one that gives the gradient of f."""
        reason = material.why_no_gradient() if self.objective == "both" else ""
        return not reason, reason

    def build(self, material: Material) -> nn.Module:
        """See :meth:`ModuleMethod.build`."""
        return Conditioners(material, self.width, self.layers, self.bins)

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: both scales at their least and their greatest."""
        n, found = spline.outputs(self.bins), {}
        for name, raw in (("scale-to-0", -FAR), ("scale-to-infinity", FAR)):
            state = held(self.state_dict(), "first.layers.1", slice(n, n + 1), raw)
            found[name] = held(state, f"second.layers.{self.layers}", slice(n, n + 1), raw)
        return found

    # --- fitting -----------------------------------------------------------------------

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`FlowMethod.fit`."""
        able, reason = self.supports(material)
        if not able:
            raise Unsupported(reason)
        self._drawn = None
        try:
            return super().fit(material, budget, generator)
        finally:
            self._drawn = None

    def loss(self, targets: Targets, budget: Budget, generator: torch.Generator) -> Tensor:
        """See :meth:`ModuleMethod.loss`."""
        if self._drawn is None:
            self._drawn = Drawn(targets, budget.directions, generator)
        condition, wo = self._drawn.batch(budget.conditions, generator)
        forward = -self.log_prob(condition, wo).mean()
        if self.objective == "forward":
            return forward
        return forward + self.mixture_divergence(condition, budget.directions, generator)

    def mixture_divergence(
        self, condition: Tensor, directions: int, generator: torch.Generator
    ) -> Tensor:
        r"""KL(p || p*) but for a constant, of both branches: each has its share of the samples.

        .. math:: E_{p}\Big[\log\frac pf\Big] = (1 - \varepsilon)\,E_q\Big[\log\frac pf\Big]
                  + \varepsilon\,E_{1/\pi}\Big[\log\frac pf\Big]
        """
        u = stratified_uniforms(len(condition), directions, generator, condition.device)
        wo, log_p = self.density_of_drawn(condition, torch.logit(u, eps=2.0**-25))
        own = self._log_excess(condition, plane.off_the_rim(wo), log_p)
        u = stratified_uniforms(len(condition), directions, generator, condition.device)
        elsewhere = plane.off_the_rim(square_to_disk(u))
        spread = self._log_excess(condition, elsewhere, self.log_prob(condition, elsewhere))
        raw = self.share_logit(self.module, condition)[:, 0]
        share = self.uniform + (1 - self.uniform) * torch.sigmoid(raw)
        return ((1 - share) * own + share * spread).mean()

    def _log_excess(self, condition: Tensor, wo: Tensor, log_p: Tensor) -> Tensor:
        """Mean of log p - log f [B] over the directions ``wo`` [B, D, 2] of each condition."""
        return (log_p - (target_of(self.material, condition, wo) + LEAST).log()).mean(1)

    def density_of_drawn(self, condition: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Directions [B, D, 2] of the logistic points ``z`` [B, D, 2], and their log p [B, D].

        The density is that of the unrounded direction, from the coordinates of the plane. Back
        from the rounded direction the gradients of map and density, both in proportion to the
        inverse distance from the rim, would cancel but for noise.
        """
        net = self.module
        encoded = net.encoder(condition)
        at, one, two = self._to_plane(net, encoded, z)
        back, slope = self._to_line(one, one[..., -5:-1:2], at[0])
        line = two[..., -2:] + one[..., -4:-1:2]
        back_2, slope_2 = self._to_line(two, line, at[1])
        flow = self.log_base(torch.stack([back, back_2], -1)) + slope + slope_2
        flow = flow + plane.log_density_of_plane(*at)
        # Every point of the plane is inside of the disk, however its direction rounds.
        log_p = defensive.log_mixed_logit(flow, torch.zeros_like(z), one[:, 0, -1:], self.uniform)
        return plane.disk_of_plane(*at), log_p

    def share_logit(self, net: Conditioners, condition: Tensor) -> Tensor | None:
        """See :meth:`FlowMethod.share_logit`."""
        return net.first(net.encoder(condition))[:, -1:]

    def log_base(self, z: Tensor) -> Tensor:
        """See :meth:`FlowMethod.log_base`: logistic."""
        return plane.log_logistic(z).sum(-1)

    def base_uniforms(self, z: Tensor) -> Tensor:
        """See :meth:`FlowMethod.base_uniforms`."""
        return torch.sigmoid(z).clamp(max=1 - 2.0**-24)

    def base_points(self, rows: int, generator: torch.Generator) -> Tensor:
        """See :meth:`FlowMethod.base_points`."""
        u = torch.rand(rows, 1, 2, generator=generator, dtype=torch.float64)
        return torch.logit(u, eps=2.0**-25)

    def followed(self, wo: Tensor) -> Tensor:
        """See :meth:`FlowMethod.followed`: nearer to the rim no state's chord is known."""
        return wo.norm(dim=-1) < 1 - plane.RIM

    def to_base(self, net: Conditioners, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`FlowMethod.to_base`."""
        at = plane.plane_of_disk(wo)
        encoded = net.encoder(condition)
        one = net.first(encoded)[:, None]
        z1, slope = self._to_line(one, one[..., -5:-1:2], at.a)
        two = net.given_x(wo[..., 0], torch.tanh(z1 / 2), encoded)
        line = two[..., -2:] + one[..., -4:-1:2]
        z2, slope_2 = self._to_line(two, line, at.b)
        return torch.stack([z1, z2], -1), slope + slope_2 + at.log_density

    def from_base(self, net: Conditioners, condition: Tensor, z: Tensor) -> Tensor:
        """See :meth:`FlowMethod.from_base`."""
        at, _, _ = self._to_plane(net, net.encoder(condition), z)
        return plane.disk_of_plane(*at)

    def _to_plane(
        self, net: Conditioners, encoded: Tensor, z: Tensor
    ) -> tuple[tuple[Tensor, Tensor], Tensor, Tensor]:
        """Coordinates (a, b), each [B, D], of ``z``, and what both networks gave for them."""
        one = net.first(encoded)[:, None]
        z1, z2 = z.unbind(-1)
        a = self._from_line(one, one[..., -5:-1:2], z1)
        two = net.given_x(torch.tanh(a / 2), torch.tanh(z1 / 2), encoded)
        b = self._from_line(two, two[..., -2:] + one[..., -4:-1:2], z2)
        return (a, b), one, two

    def _to_line(self, numbers: Tensor, line: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
        """z [B, D] of a coordinate, and the log slope; ``line`` is log scale and shift."""
        log_scale, n = lobes.log_sigma(line[..., 0]), spline.outputs(self.bins)
        z, slope = spline.warp(
            numbers[..., :n], (at - line[..., 1]) * torch.exp(-log_scale) / BOUND
        )
        return z * BOUND, slope - log_scale

    def _from_line(self, numbers: Tensor, line: Tensor, z: Tensor) -> Tensor:
        """The coordinate [B, D] of z."""
        n = spline.outputs(self.bins)
        bent = spline.unwarp(numbers[..., :n], z / BOUND)
        return line[..., 1] + torch.exp(lobes.log_sigma(line[..., 0])) * BOUND * bent

    # --- sampling ----------------------------------------------------------------------

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        net, n = self.module, spline.outputs(self.bins)
        encoded = net.encoder.encoded(c)
        one = net.first.columns(encoded)
        share = defensive.share_columns(one[-1], self.uniform)
        elsewhere = u[2] < share
        there = defensive.uniform_disk_columns(u)
        line = lobes.log_sigma_columns(one[n]), one[n + 2]
        x, bin_x = self._draw(one, line, u[0], plane.a_columns(there[0]), elsewhere)
        x = dr.select(elsewhere, there[0], plane.x_columns(x))
        z, slope = self._back(bin_x, line, plane.a_columns(x))
        base, rank = plane.logistic_pdf_columns(z)
        two = net.columns_given_x(x, rank, encoded)
        line = lobes.log_sigma_columns(two[n] + one[n + 1]), two[n + 1] + one[n + 3]
        there_b, _ = plane.b_columns(*there)
        b, bin_y = self._draw(two, line, u[1], there_b, elsewhere)
        y = dr.select(elsewhere, there[1], plane.y_columns(b, plane.chord_columns(x)))
        b, density = plane.b_columns(x, y)
        z, slope_2 = self._back(bin_y, line, b)
        density = density * base * slope * slope_2 * plane.logistic_pdf_columns(z)[0]
        return x, y, defensive.mixed_columns(density, [x, y], share)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        net, n = self.module, spline.outputs(self.bins)
        x, y = wo
        encoded = net.encoder.encoded(c)
        one = net.first.columns(encoded)
        line = lobes.log_sigma_columns(one[n]), one[n + 2]
        z, slope = spline.warp_columns(one[:n], self._scaled(line, plane.a_columns(x)))
        base, rank = plane.logistic_pdf_columns(BOUND * z)
        two = net.columns_given_x(x, rank, encoded)
        line_2 = lobes.log_sigma_columns(two[n] + one[n + 1]), two[n + 1] + one[n + 3]
        b, density = plane.b_columns(x, y)
        z, slope_2 = spline.warp_columns(two[:n], self._scaled(line_2, b))
        slope, slope_2 = slope * dr.exp(-line[0]), slope_2 * dr.exp(-line_2[0])
        density = density * base * slope * slope_2 * plane.logistic_pdf_columns(BOUND * z)[0]
        share = defensive.share_columns(one[-1], self.uniform)
        return defensive.mixed_columns(density, [x, y], share)

    def _draw(
        self, numbers: Columns, line: tuple[Float, Float], u: Float, there: Float, keep: Any
    ) -> tuple[Float, spline.Bin]:
        """A coordinate of a uniform, and its bin of the spline; ``there`` and its, if ``keep``."""
        n = spline.outputs(self.bins)
        z = plane.logistic_columns(u) * (1 / BOUND)
        bent, found = spline.unwarp_or_keep_columns(numbers[:n], z, self._scaled(line, there), keep)
        return dr.fma(BOUND * bent, dr.exp(line[0]), line[1]), found

    def _back(self, found: spline.Bin, line: tuple[Float, Float], at: Float) -> tuple[Float, Float]:
        """z of a coordinate whose bin is known, and the slope there."""
        z, slope = spline.evaluate_columns(found, self._scaled(line, at))
        return BOUND * z, slope * dr.exp(-line[0])

    @staticmethod
    def _scaled(line: tuple[Float, Float], at: Float) -> Float:
        return (at - line[1]) * (dr.exp(-line[0]) * (1 / BOUND))
