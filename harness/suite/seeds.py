"""The two kinds of seeds: of a fit, and of what is measured with it."""

from __future__ import annotations

from harness.core.protocol.errors import InputError

APART = 1000
"""Between the measuring seeds of two fits: fits are measured independently of one another."""


def pairs(seeds: list[int], training_seeds: list[int] | None) -> list[tuple[int, int]]:
    """Pairs (training seed, measuring seed) of a suite, in order.

    Without ``training_seeds`` every seed is both. With them, each fit is measured with every one
    of ``seeds``, ``APART`` times its own training seed further on: the noise of two fits' numbers
    is then independent, so that their spread is that of the fits and of the noise together, and
    their mean has less of both.

    Raises:
        InputError: two fits would be measured with the same seed.
    """
    if training_seeds is None:
        return [(seed, seed) for seed in seeds]
    found = [(fit, seed + APART * fit) for fit in training_seeds for seed in seeds]
    if len({seed for _, seed in found}) < len(found):
        raise InputError(
            f"seeds: expected seeds less than {APART} apart where there are training_seeds,"
            f" got {seeds}"
        )
    return found
