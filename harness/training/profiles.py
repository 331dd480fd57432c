"""How much a training may spend."""

from __future__ import annotations

from dataclasses import dataclass, replace

from harness.core.protocol.errors import InputError, nearest
from harness.materials.neural.architecture import NEUMIP, NEUSAMPLE, Architecture


@dataclass(frozen=True)
class Profile:
    """``queries`` random queries of ``samples`` paths each, then two stages of Adam.

    The first takes ``steps`` steps of ``batch`` queries while a Gaussian blur of the textures, of
    ``blur`` of a texture's width at first, decays: NeuMIP's 8 texels of 512, halved nine
    times over. The second, ``final_steps`` steps of ``final_batch``, has no blur and a lower
    step size, which falls to nothing. The step sizes are of the textures and of the networks;
    ``floor`` is the reflectance below which the loss counts errors absolutely. Those of the
    offset are a share ``offset_share`` of them: a depth is in widths of the tile, and steps of
    5e-3 move lookups by whole texels before the textures hold anything. With ``offset_steps`` the
    offset is first taught, in so many steps, where traced rays hit (``parallax.py``), where the
    surface can tell; it then stands still in the first stage and has a share ``taught_share`` in
    the second. With ``energy_steps`` so many more end the training, in which it is taught
    energies too (``energy.py``), where the surface can tell.
    """

    architecture: Architecture
    queries: int
    samples: int
    steps: int
    batch: int
    final_steps: int
    final_batch: int
    texture_rate: float = 2e-2
    network_rate: float = 3e-3
    offset_share: float = 1.0
    offset_steps: int = 0
    taught_share: float = 0.02
    energy_steps: int = 0
    final_share: float = 0.3
    blur: float = 1 / 64
    halvings: float = 9.0
    floor: float = 0.05


_SMALL = replace(
    NEUSAMPLE,
    resolution=128,
    offset_resolution=128,
    half_vector=True,
    cosines=True,
    output="log1p",
)
_SMALL_PYRAMID = replace(NEUMIP, resolution=128, offset_resolution=128)
_MINUTES = Profile(
    _SMALL,
    queries=8 << 20,
    samples=4,
    steps=2000,
    batch=1 << 13,
    final_steps=600,
    final_batch=1 << 15,
    texture_rate=5e-2,
    network_rate=2e-2,
    offset_share=0.3,
    halvings=5.0,
    floor=0.05,
)
_RELIEF = replace(
    _MINUTES,
    queries=24 << 20,
    steps=5000,
    final_steps=1500,
    texture_rate=3e-2,
    offset_steps=4000,
    energy_steps=800,
)

PROFILES = {
    # Two minutes of one core.
    "quick": replace(_MINUTES, texture_rate=3e-2, offset_steps=3000, energy_steps=200),
    "quick-pyramid": replace(_MINUTES, architecture=_SMALL_PYRAMID),
    # What ships was made by the next two: the offset knows the relief before anything else is
    # learned.
    "relief": _RELIEF,
    # For what needs more of everything.
    "deep": replace(_RELIEF, queries=40 << 20, steps=8000, final_steps=2400, offset_steps=8000),
    # The papers' sizes: 300 queries a texel of 512^2, batches of a million. For a GPU.
    "full": Profile(NEUSAMPLE, 80 << 20, 64, 27000, 1 << 20, 3000, 1 << 20),
    "full-pyramid": Profile(NEUMIP, 80 << 20, 64, 27000, 1 << 20, 3000, 1 << 20),
}


def profile(name: str) -> Profile:
    """The profile of that name; :class:`InputError` if there is none."""
    if name not in PROFILES:
        raise InputError(f"--profile: unknown profile '{name}'{nearest(name, PROFILES)}")
    return PROFILES[name]
