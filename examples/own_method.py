"""A method of one's own, fitted to a material, in a picture: writes own_method.png."""

from __future__ import annotations

import math

import mitsuba as mi
import torch

import harness


class MirrorLobe(harness.Method):
    """Half uniform on the disk, half a Gaussian of width ``sigma`` at the mirrored direction."""

    def __init__(self, sigma: float = 0.2):
        self.sigma = sigma

    def sample(self, condition, u):
        angle = 2 * math.pi * u[:, 2]
        unit = torch.stack([angle.cos(), angle.sin()], 1)
        disk = u[:, 1:2].sqrt() * unit
        lobe = (-2 * torch.log1p(-u[:, 1:2])).sqrt() * self.sigma * unit - condition[:, -2:]
        wo = torch.where(u[:, :1] < 0.5, disk, lobe)
        return harness.DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition, wo):
        z = (wo + condition[:, -2:]) / self.sigma
        lobe = torch.exp(-0.5 * z.square().sum(1)) / (2 * math.pi * self.sigma**2)
        return 0.5 * (wo.square().sum(1) < 1) / math.pi + 0.5 * lobe


sampler = harness.fit(MirrorLobe, "suede", sigma=0.3)
image = harness.render(sampler, "draped-cloth", resolution=48, spp=16)
mi.util.write_bitmap("own_method.png", image.rgb)
print(f"variance of one sample, mean over the pixels: {image.variance.mean():.3g}")
