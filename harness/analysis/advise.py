"""Which method to use for so many samples, by how much, and over which range that holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from harness.analysis import numbers
from harness.analysis.bias import bias_warnings
from harness.analysis.breakeven import TIMES, VARIANCES, CostLine, costs, timed_scenes
from harness.analysis.results import Results
from harness.core.protocol.errors import InputError, nearest
from harness.stats.crossing import Crossing, envelope
from harness.stats.intervals import Interval, interval_of_draws


@dataclass(frozen=True)
class End:
    """One end of the range: where it lies, between which bounds, and who takes over there."""

    at: float
    low: float
    high: float
    method: str


@dataclass(frozen=True)
class Advice:
    """For one material in one scene, and ``samples`` of the baseline over all pixels.

    ``margin``: total time of the runner-up over that of ``method``. ``start`` and ``end``
    bound the range over which ``method`` stays the fastest; None where it has no end.
    """

    material: str
    scene: str
    reference: str
    samples: float
    shipped: bool
    method: str
    seconds: Interval
    runner_up: str
    margin: Interval
    surest: float
    start: End | None
    end: End | None
    left_out: dict[str, str] = field(default_factory=dict)
    marks: dict[str, str] = field(default_factory=dict)

    @property
    def tie(self) -> bool:
        """Whether the two cannot be told apart."""
        return self.margin.low <= 1

    def lines(self) -> list[str]:
        """As text."""
        said = [
            f"{self.material} in {self.scene}, {numbers.count(self.samples)} samples of "
            f"{self.reference} or what equals them in error"
            + (", fits shipped" if self.shipped else ", fits made here"),
            f"  use        {self.method}: {numbers.duration_with_interval(*self.seconds)}",
        ]
        if not self.runner_up:
            said.append("  runner-up  none: no other method has a number")
        else:
            value, interval = numbers.with_interval(*self.margin)
            said.append(f"  runner-up  {self.runner_up}: {value}× the time {interval}")
            if self.tie:
                said.append(
                    "  a tie: the interval of the margin includes 1; "
                    f"{self.method} is the fastest of all in {self.surest:.0%} of the draws"
                )
        said.append(f"  holds      {self._range()}")
        said += [f"  mark       {label}: {why}" for label, why in self.marks.items()]
        said += [f"  left out   {label}: {why}" for label, why in self.left_out.items()]
        return said

    def _range(self) -> str:
        if self.start is None and self.end is None:
            return "for any number of samples"
        start = (
            "from the first sample" if self.start is None else f"from {_end(self.start, 'below')}"
        )
        end = "on" if self.end is None else f"to {_end(self.end, 'above')}"
        return f"{start} {end}"


def advise(
    folder: str | Path,
    material: str,
    samples: float,
    scene: str | None = None,
    shipped: bool = False,
) -> list[Advice]:
    """One piece of advice for each scene (or the one named), from stored results.

    Raises:
        InputError: no such folder, material or scene; no count of samples; nothing measured.
    """
    if not (samples > 0 and math.isfinite(samples)):
        raise InputError(f"--samples: expected a number above zero, as 64e6, got {samples:g}")
    results = Results.load(folder)
    if material not in results.materials:
        hint = nearest(material, results.materials)
        raise InputError(f"{folder}: --material: no results for '{material}'{hint}")
    scenes = timed_scenes(results)
    if not scenes:
        raise InputError(
            f"{folder}: holds no times per sample; advice takes a suite with the measure "
            f"{' or '.join(TIMES)}, and a variance from {' or '.join(VARIANCES[:2])}"
        )
    if scene is not None and scene not in scenes:
        raise InputError(f"{folder}: --scene: no times in '{scene}'{nearest(scene, scenes)}")
    chosen = scenes if scene is None else [scene]
    return [_one(results, material, place, samples, shipped) for place in chosen]


def _one(results: Results, material: str, scene: str, samples: float, shipped: bool) -> Advice:
    found = costs(results, material, scene, shipped)
    if isinstance(found, str):
        raise InputError(f"{results.folder}: samples are counted in those of {found}")
    warnings = bias_warnings(results)
    left_out = dict(found.missing)
    for label, line in found.lines.items():
        if line.method.ceiling:
            left_out[label] = "the ceiling: too large to be used"
        elif doubt := warnings(material, label, scene):
            left_out[label] = doubt
    lines = {label: line for label, line in found.lines.items() if label not in left_out}
    if not lines:
        raise InputError(f"{results.folder}: no method has a number on {material} in {scene}")
    totals = {label: line.total(samples) for label, line in lines.items()}
    start, end, best = _range_at(lines, samples)
    ranked = [best, *sorted(lines.keys() - {best}, key=lambda label: totals[label][0])]
    second = ranked[1] if len(ranked) > 1 else ""
    margin = _interval(totals[second] / totals[best]) if second else Interval(*[float("nan")] * 3)
    all_draws = np.stack([totals[label][1:] for label in ranked])
    return Advice(
        material,
        scene,
        found.reference,
        samples,
        shipped,
        best,
        _interval(totals[best]),
        second,
        margin,
        float((all_draws.argmin(0) == 0).mean()),
        start,
        end,
        left_out,
        {label: lines[label].mark for label in ranked[:2] if lines[label].mark},
    )


def _range_at(lines: dict[str, CostLine], samples: float) -> tuple[End | None, End | None, str]:
    """The lowest line at ``samples``, and both ends of the range over which it is that."""
    labels = list(lines)
    pieces = [
        (labels[i], upper)
        for i, _, upper in envelope(
            [line.fixed[0] for line in lines.values()], [line.slope[0] for line in lines.values()]
        )
    ]
    here = next(i for i, (_, upper) in enumerate(pieces) if samples < upper)
    best, before, after = pieces[here][0], None, None
    if here:
        rival = pieces[here - 1][0]
        before = _end_of(lines[best].against(lines[rival]), rival)
    if here < len(pieces) - 1:
        rival = pieces[here + 1][0]
        after = _end_of(lines[rival].against(lines[best]), rival)
    return before, after, best


def _end_of(crossing: Crossing, rival: str) -> End:
    return End(crossing.at, crossing.low, crossing.high, rival)


def _interval(drawn: np.ndarray) -> Interval:
    """Value, and the central 95 % of the draws, of [1 + R]."""
    low, high = interval_of_draws(drawn[1:])
    return Interval(float(drawn[0]), float(low), float(high))


def _end(end: End, side: str) -> str:
    at, low, high = (
        "∞" if math.isinf(v) else numbers.count(v) for v in (end.at, end.low, end.high)
    )
    return f"{at} [{low}, {high}] ({end.method} {side})"
