"""How much a training from walks may spend."""

from __future__ import annotations

from dataclasses import dataclass, replace

from harness.core.protocol.errors import InputError, nearest
from harness.materials.puresample.architecture import Architecture

ALBEDO_LOSSES = ("survival", "squared", "l1")


@dataclass(frozen=True)
class Profile:
    """``walks`` particles for the density; then three fits by Adam, each with a cosine of its rate.

    *Matching* (eq. 3) in ``matching_steps`` of ``matching_batch`` particles; *likelihood* of the
    very steps that run, in ``likelihood_steps`` of ``likelihood_batch``, which is ours and replaces
    Reflow (:mod:`harness.fitting.flow_matching`); the *albedo*, from ``directions`` of ``group``
    particles a channel each, in ``albedo_steps`` of ``albedo_batch`` directions by ``albedo_loss``
    (:mod:`harness.training.puresample.albedo`). ``texture_rate`` and ``tv``, the weight of the
    total variation per texel and channel (eq. 4), are the latent texture's. The albedo's fit leaves
    the density's channels alone, and has ``albedo_channels`` of its own.
    """

    architecture: Architecture
    walks: int
    matching_steps: int
    matching_batch: int
    likelihood_steps: int
    likelihood_batch: int
    directions: int
    group: int
    albedo_steps: int
    albedo_batch: int = 4096
    albedo_loss: str = "survival"
    matching_rate: float = 4e-3
    likelihood_rate: float = 2e-3
    albedo_rate: float = 5e-3
    texture_rate: float = 2e-2
    tv: float = 1e-2


_MINUTES = Profile(
    Architecture(),
    walks=4 << 20,
    matching_steps=300,
    matching_batch=1 << 13,
    likelihood_steps=250,
    likelihood_batch=1 << 11,
    directions=1 << 17,
    group=32,
    albedo_steps=2500,
)
_TEXTURE = Architecture(
    width=128, albedo_width=128, albedo_layers=5, residual=True, resolution=256, channels=32
)

PROFILES = {
    # Four minutes of two cores.
    "quick": _MINUTES,
    # A quarter of an hour.
    "fine": replace(
        _MINUTES,
        walks=16 << 20,
        matching_steps=600,
        likelihood_steps=1500,
        directions=1 << 19,
        albedo_steps=5000,
    ),
    # Latent texture of 64 texels and 8 channels, 4 more for the albedo, and narrower networks.
    "quick-texture": replace(
        _MINUTES,
        architecture=replace(
            _TEXTURE, width=64, albedo_width=64, resolution=64, channels=8, albedo_channels=4
        ),
        walks=16 << 20,
        matching_steps=1500,
        likelihood_steps=600,
        directions=1 << 20,
        group=2,
    ),
    # The sizes and losses of the paper, fifty steps without Reflow, for a GPU.
    "full": Profile(
        Architecture(domain="disk", base="normal", steps=50, frequencies=0, share=0.0),
        walks=4096 * 5000,
        matching_steps=20_000,
        matching_batch=1 << 19,
        likelihood_steps=0,
        likelihood_batch=1,
        directions=4096,
        group=5000,
        albedo_steps=3000,
        albedo_loss="l1",
        matching_rate=3e-3,
        albedo_rate=1e-4,
    ),
    "full-texture": Profile(
        replace(_TEXTURE, domain="disk", base="normal", steps=50, frequencies=0, share=0.0),
        walks=500_000_000,
        matching_steps=100_000,
        matching_batch=1 << 19,
        likelihood_steps=0,
        likelihood_batch=1,
        directions=1_000_000,
        group=100,
        albedo_steps=3000,
        albedo_loss="l1",
        matching_rate=3e-3,
        albedo_rate=1e-4,
    ),
}


def profile(name: str) -> Profile:
    """The profile of that name; :class:`InputError` if there is none."""
    if name not in PROFILES:
        raise InputError(f"--profile: unknown profile '{name}'{nearest(name, PROFILES)}")
    return PROFILES[name]
