"""Time of a neural material's two stages, beside a bare network of its decoder's size."""

from __future__ import annotations

from collections.abc import Callable

from harness.core.protocol.errors import Unsupported
from harness.materials.neural.material import NeuralMaterial
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.stage_times import run


class Stages(Measure):
    """Seconds per million rows of stage 1 (offset and lookup) and stage 2 (decoder).

    NeuMIP's Figure 9. ``bare-seconds`` is a torch network of the decoder's size in its faster
    form, whole or in chunks, timed in the same interleaved rounds; ``stage-2-ratio`` is stage 2
    over it. Medians over the rounds with 95 % intervals. The method plays no part.
    """

    name = "stages"
    timed = True
    needs_scene = False

    class Settings(BaseSettings):
        """``rows`` directions at a time."""

        rows: int = 1 << 20
        rounds: int = 11

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job) for job in jobs]

    def _one(self, job: Job) -> Outcome:
        settings = self.Settings(**job.settings)
        if not isinstance(job.material, NeuralMaterial):
            raise Unsupported(f"material '{job.material.name}' is not neural")
        timing = run(job.material, settings.rows, settings.rounds, job.budget.device)
        arrays = {name.replace(" ", "-"): single(x) for name, x in timing.seconds.items()}
        return Outcome(arrays=arrays)
