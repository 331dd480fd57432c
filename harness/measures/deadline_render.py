"""Rendering to a deadline: in chunks, the last one sized to end on time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from harness.rendering.passes import Pass

CHUNKS = 10
"""Chunks to a deadline: enough to correct the speed, few enough to stay large."""


class DeadlineRender:
    """One method on its way to ``deadline`` seconds of rendering.

    ``render(spp, seed)`` gives a finished pass; ``per_spp`` is the speed known beforehand, in
    seconds. ``image`` [H, W, 3] is the mean so far. Its own seconds count, and nobody else's.
    """

    def __init__(
        self, render: Callable[[int, int], Pass], per_spp: float, deadline: float, seed: int
    ):
        self.render, self.deadline, self.seed = render, deadline, seed
        self.known = per_spp
        self.chunks: list[tuple[int, float]] = []
        self._total: NDArray | float = 0.0

    @property
    def spp(self) -> int:
        """Samples per pixel so far."""
        return sum(count for count, _ in self.chunks)

    @property
    def seconds(self) -> float:
        """Seconds of rendering so far."""
        return sum(seconds for _, seconds in self.chunks)

    @property
    def image(self) -> NDArray:
        """Mean of all chunks."""
        return np.asarray(self._total) / self.spp

    @property
    def miss(self) -> float:
        """How far past the deadline, over the deadline; negative for too early."""
        return self.seconds / self.deadline - 1

    def next_count(self) -> int:
        """Samples of the next chunk: 0 at the end, where one more would go further off."""
        per_spp = float(np.median([s / n for n, s in self.chunks])) if self.chunks else self.known
        left = self.deadline - self.seconds
        fits = round(left / per_spp)
        if fits < 1:
            return 0 if self.chunks else 1
        chunk = self.deadline / CHUNKS
        # What is left over goes with the last chunk: a sliver's time is all overhead.
        return fits if left < 1.5 * chunk else max(1, round(chunk / per_spp))

    def step(self) -> bool:
        """Render one chunk; False if there is none left."""
        count = self.next_count()
        if count == 0:
            return False
        rendered = self.render(count, self.seed + self.spp)
        self.chunks.append((count, rendered.seconds))
        self._total = self._total + rendered.rgb * count
        return True


def render_to_deadlines(renders: Sequence[DeadlineRender]) -> None:
    """All to their deadlines, a chunk each one after the other: a slow spell hits all alike."""
    going = list(renders)
    while going:
        going = [one for one in going if one.step()]
        going = going[1:] + going[:1]
