r"""Gaussian lobes on the disk over a diffuse base, where lobes are hard to follow.

.. math:: f(\omega) = \frac{\rho}{\pi} + \sum_l e_l\,\mathcal{N}(\omega;\,\mu_l, \sigma_l), \qquad
   \int f\,dA = \rho + \sum_l e_l\,P\!\left[\chi'^2_2(|\mu_l|^2/\sigma_l^2) < \sigma_l^{-2}\right]

The share of an isotropic Gaussian inside the disk is a non-central chi-square's: two degrees
of freedom, the squared distance of its centre in units of sigma.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from pathlib import Path
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from harness.core.protocol.disk import luminance
from harness.materials.hard.base import DiskMaterial, Made


class Lobe(NamedTuple):
    """``energy`` of the whole Gaussian, its ``sigma``, and its ``centre`` [..., 2]."""

    energy: float
    sigma: float
    centre: Tensor


class Lobes(DiskMaterial):
    """A diffuse base of albedo ``base`` and the Gaussians that :meth:`lobes` gives."""

    base: ClassVar[float] = 0.1

    @abstractmethod
    def lobes(self, condition: Tensor) -> list[Lobe]:
        """At ``condition`` [..., C]."""

    def factor(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.factor`."""
        value = torch.as_tensor(self.base / math.pi, dtype=wo.dtype, device=wo.device)
        for energy, sigma, centre in self.lobes(condition):
            square = ((wo - centre) / sigma).square().sum(-1)
            value = value + energy / (2 * math.pi * sigma**2) * torch.exp(-0.5 * square)
        return value

    def albedo(self, condition: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.albedo`."""
        from scipy.stats import ncx2

        total = torch.full((len(condition),), self.base, dtype=torch.float64)
        for energy, sigma, centre in self.lobes(condition.double()):
            distance = (centre / sigma).square().sum(-1).cpu().numpy()
            total += energy * torch.from_numpy(ncx2.cdf(sigma**-2, 2, distance))
        return total.to(condition) * luminance(condition.new_tensor(self.colour))

    def peaks(self, condition: Tensor) -> Tensor:
        """See :meth:`Material.peaks`."""
        centres = [lobe.centre.expand(len(condition), 2) for lobe in self.lobes(condition)]
        return torch.stack(centres, 1)


class BelowHorizon(Lobes):
    """A lobe whose centre lies outside the disk; 2 to 31 % of it are above the horizon.

    A glossy surface under a normal map seen from the side: the mirror direction of the bent
    normal is below the true surface. The lobe's tail is all there is, 230 powers of e deep.
    """

    base = 0.0

    def lobes(self, condition: Tensor) -> list[Lobe]:
        """See :meth:`Lobes.lobes`."""
        offset = condition.new_tensor([1.13, 0.0])
        return [Lobe(1.0, 0.1, offset - 0.08 * condition[..., -2:])]


class RimLobe(Lobes):
    """Half of the energy in a lobe of sigma 0.01 at radius 0.999, which the rim cuts in two.

    The highlight of a wet road against the sun, or a retroreflector lit from the side. It
    turns about the normal as wi moves.
    """

    def lobes(self, condition: Tensor) -> list[Lobe]:
        """See :meth:`Lobes.lobes`."""
        turn = 2 + condition[..., -2]
        centre = 0.999 * torch.stack([turn.cos(), turn.sin()], -1)
        return [Lobe(0.5, 0.01, centre)]


class DistantLobes(Lobes):
    """Five narrow lobes far apart, of 50, 25, 16, 8 and 1 % of their energy.

    Cut glass beads, sequins, prismatic sheeting: each facet has a mirror direction of its
    own. All move with wi, by different amounts.
    """

    base = 0.05
    LOBES = (
        (0.400, 0.03, 0.75, 0.4, -0.20),
        (0.200, 0.02, 0.80, 1.9, -0.10),
        (0.128, 0.02, 0.55, 3.1, -0.30),
        (0.064, 0.01, 0.85, 4.2, -0.05),
        (0.008, 0.01, 0.65, 5.4, -0.25),
    )
    """Energy, sigma, radius and azimuth of the centre at normal incidence, share of wi added."""

    def lobes(self, condition: Tensor) -> list[Lobe]:
        """See :meth:`Lobes.lobes`."""
        wi, found = condition[..., -2:], []
        for energy, sigma, radius, turn, share in self.LOBES:
            home = wi.new_tensor([radius * math.cos(turn), radius * math.sin(turn)])
            found.append(Lobe(energy, sigma, home + share * wi))
        return found


class BlueOnly(Lobes):
    """A diffuse base and a lobe in the blue channel alone; red and green are exactly zero.

    Saturated pigment, or one channel of a spectral render. Luminance sees 7 % of its energy;
    nothing else about its shape is difficult.
    """

    colour = (0.0, 0.0, 1.0)
    base = 0.3

    def lobes(self, condition: Tensor) -> list[Lobe]:
        """See :meth:`Lobes.lobes`."""
        return [Lobe(0.4, 0.15, -0.8 * condition[..., -2:])]


_HERE = Path(__file__)
MATERIALS = {
    "below-horizon": Made("a lobe mostly below the horizon", _HERE, BelowHorizon),
    "rim-lobe": Made("half of the energy in a narrow lobe on the disk's rim", _HERE, RimLobe),
    "distant-lobes": Made("five narrow lobes far apart, the weakest of 1 %", _HERE, DistantLobes),
    "blue-only": Made("energy in the blue channel alone", _HERE, BlueOnly),
}
