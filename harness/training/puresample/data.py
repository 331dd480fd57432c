"""Walks to learn from: where particles go, and which come back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.streams import generator
from harness.microgeometry.walks.kernel import Counts

LANES = 1 << 20
_LEAST = 1e-3
"""Share of particles that has to come back for there to be anything to learn."""
_UNFINISHED = 1e-3
"""Share of particles that may be given up."""
_ABOVE = 5e-3
"""Share of interactions whose weight may be above one."""


@dataclass(frozen=True)
class Walked:
    """Particles, one a row: places, directions in, channels, directions out, who left."""

    u: Tensor
    wi: Tensor
    channel: Tensor
    wo: Tensor
    left: Tensor
    counts: Counts

    def __len__(self) -> int:
        return len(self.u)

    def survivors(self) -> Walked:
        """Those that left, in directions that single precision tells from horizontal.

        At a cosine below 2.4e-4 x^2 + y^2 rounds to one, where a density per disk area has no
        value: of light that is uniform on the disk a share of 6e-8.
        """
        keep = self.left & inside_disk(self.wo)
        parts = (x[keep] for x in (self.u, self.wi, self.channel, self.wo, self.left))
        return Walked(*parts, self.counts)


def draw(source: Any, count: int, seed: int, device: str = "cpu") -> Walked:
    """``count`` walks: places uniform in the tile, ``wi`` uniform on the disk, channels in turn.

    ``source`` has ``walk(u, wi, channel, seed, device)`` and a ``name``. (The paper draws wi
    uniformly over the hemisphere; the harness asks for conditions uniform on the disk.)
    """
    parts, counts = [], Counts()
    for first in range(0, count, LANES):
        n = min(LANES, count - first)
        random = generator(seed + (first << 8))
        u = torch.rand(n, 2, generator=random)
        wi = square_to_disk(torch.rand(n, 2, generator=random))
        channel = torch.arange(n) % 3
        found = source.walk(u, wi, channel, seed + (first << 8) + 1, device)
        counts.add(found.counts)
        parts.append((u, wi, channel, found.wo.cpu(), found.left.cpu()))
    return Walked(*(torch.cat(x) for x in zip(*parts, strict=True)), counts)


def check(source: Any, counts: Counts) -> None:
    """Refuse a surface that nothing can be learned of; one line says why.

    Raises:
        InputError: all is absorbed, walks do not end, or weights are above one.
    """
    if counts.unfinished > _UNFINISHED * counts.walks:
        share = counts.unfinished / counts.walks
        raise InputError(
            f"{source.name}: {share:.1%} of the particles had not left after their bound of"
            f" interactions; expected at most {_UNFINISHED:.1%}: a larger 'bound', or a surface"
            " that lets them out or absorbs them"
        )
    if counts.left < _LEAST * counts.walks:
        raise InputError(
            f"{source.name}: {counts.left} of {counts.walks} particles leave, the others are"
            f" absorbed; expected {_LEAST:.1%} at least, or there is nothing to learn"
        )
    if counts.above_one > _ABOVE * counts.interactions:
        share = counts.above_one / counts.interactions
        raise InputError(
            f"{source.name}: the micro-BSDF's weight is above one at {share:.1%} of the"
            f" interactions; expected at most {_ABOVE:.1%}, for a particle's weight stays one"
        )
