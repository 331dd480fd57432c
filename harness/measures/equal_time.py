"""Error at equal time: seconds per sample in interleaved rounds, then renders to a deadline."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from harness.core.protocol.errors import BudgetExceeded
from harness.measures.base import Job, Measure, Outcome
from harness.measures.compact import single
from harness.measures.deadline_render import DeadlineRender, render_to_deadlines
from harness.measures.images import checked, too_slow
from harness.measures.renders import Entrant, RenderSettings, enter
from harness.measures.timing import Timings, interleave
from harness.stats.variance import Deviations


class EqualTime(Measure):
    """Seconds per sample per pixel, and what quality the same time buys.

    After a warm-up that lasts until two renders in a row take the same time, every method
    renders for about ``slice_seconds`` in each round, see
    :func:`~harness.measures.timing.interleave`. Then each renders for ``deadline`` seconds, in
    chunks between those of the others. ``disturbed`` is 1 where an interval of the times stayed
    wider than ``tolerance``; ``deadline-missed`` is 1 where ``deadline-miss``, the achieved
    time over the deadline less one, is more than half of ``agreement`` off, so that the
    achieved times of those not marked agree within ``agreement``.

    ``speedup-equal-time`` is (variance x seconds per sample) of the baseline over that of
    the method: how much longer the baseline runs for equal quality. Times are compared
    within their round (``time-ratio``). All times are wall-clock of finished renders: tracing
    rays, evaluating the material, sampling.
    """

    name = "equal-time"
    timed = True

    class Settings(RenderSettings):
        """See :class:`RenderSettings`."""

        deadline: float = 1.0
        agreement: float = 0.03

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        settings = self.Settings(**jobs[0].settings)
        slow = [
            too_slow(j, settings.resolution, 2 * settings.rounds, settings.patience) for j in jobs
        ]
        fit = [job for job, reason in zip(jobs, slow, strict=True) if not reason]
        found = iter(self._timed(fit, settings, notify))
        return [Outcome("timeout", reason) if reason else next(found) for reason in slow]

    def _timed(
        self, jobs: list[Job], settings: Settings, notify: Callable[[str], None]
    ) -> list[Outcome]:
        base = next((i for i, job in enumerate(jobs) if job.baseline), None)
        if base is None:
            raise BudgetExceeded("the baseline is too slow for its rounds")
        entrants = [enter(job, settings, notify, i) for i, job in enumerate(jobs)]
        contenders = [e.contender(None if i == base else base) for i, e in enumerate(entrants)]
        timings = interleave(contenders, settings, notify)
        notify(f"{settings.deadline:g} s each, {len(entrants)} methods")
        renders = [
            _to_deadline(entrant, timings.median(i).value, settings.deadline)
            for i, entrant in enumerate(entrants)
        ]
        render_to_deadlines(renders)
        return [_outcome(i, entrants, base, timings, one) for i, one in enumerate(renders)]


def _outcome(
    index: int, entrants: Sequence[Entrant], base: int, timings: Timings, render: DeadlineRender
) -> Outcome:
    entrant = entrants[index]
    arrays = {
        "compared": np.array(index != base),
        "seconds": single(timings.seconds(index)),
        "baseline_seconds": single(timings.rival_seconds(index)),
        "batch_variance": single(entrant.errors),
        "baseline_variance": single(entrants[base].errors),
        "round_spp": np.array(entrant.spp),
        "chunk_spp": np.array([spp for spp, _ in render.chunks], np.int32),
        "chunk_seconds": single([seconds for _, seconds in render.chunks]),
        "loadavg": timings.loadavg,
        "mask": entrant.prepared.mask,
    }
    if len(entrant.variances) > 1:  # of one round alone nothing tells a deviation
        arrays["deviations"] = Deviations.of(entrant.variances).packed()
    return Outcome(arrays=arrays, images={"equal_time": render.image})


def _to_deadline(entrant: Entrant, per_spp: float, deadline: float) -> DeadlineRender:
    """With seeds that no round has used."""
    job, render = entrant.job, entrant.prepared.render
    return DeadlineRender(
        lambda spp, seed: checked(render(spp, seed), job),
        per_spp,
        deadline,
        900_000 + 7919 * job.seed,
    )
