"""The hard cases of the catalogue that a material stands for, with a verdict on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from pydantic import field_validator
from pydantic_core import PydanticCustomError

from harness.checks.catalogue import CATALOGUE, HardCase
from harness.checks.finding import Finding, verdict
from harness.checks.run import CASE_ALARM, run_case
from harness.core.protocol.errors import Unsupported, nearest
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings

FINDINGS = "findings"
"""Name of the document that holds them."""


class Stability(Measure):
    """A verdict on each hard case of the catalogue that is about the job's material.

    For each case the metric CASE, 0 for pass, 1 for degraded, 2 for fail; and the numbers
    CASE/efficiency, CASE/lost, CASE/tail-index, CASE/largest-weight, CASE/invalid where a
    property measured them, the worst over the case's conditions. All findings, with the worst
    inputs, are the document ``findings``. An adapter that raises has failed that case, and the
    others go on. A correct adapter fails a case with probability ``CASE_ALARM`` at most.
    """

    name = "stability"
    needs_scene = False

    class Settings(BaseSettings):
        """``cases``: names of the catalogue to be run; all of them by default."""

        cases: list[str] | None = None

        @field_validator("cases")
        @classmethod
        def _known(cls, names: list[str] | None) -> list[str] | None:
            for name in names or ():
                if name not in CATALOGUE:
                    hint = nearest(name, CATALOGUE).removeprefix("; ")
                    text = "no hard case '{name}' ({hint})"
                    raise PydanticCustomError("case", text, {"name": name, "hint": hint})
            return names

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`.

        Raises:
            Unsupported: no case asked for is about the material.
        """
        return [self._one(job, self.Settings(**job.settings)) for job in jobs]

    def _one(self, job: Job, settings: Settings) -> Outcome:
        places = {name: place for place, name in enumerate(CATALOGUE)}
        chosen = [
            case
            for case in CATALOGUE.values()
            if case.material == job.material.name
            and (settings.cases is None or case.name in settings.cases)
        ]
        if not chosen:
            raise Unsupported(f"no hard case of the catalogue asks for {job.material.name}")
        described = []
        for case in chosen:
            findings = _findings(job, case)
            described.append(_described(case, places[case.name], verdict(findings), findings))
        return Outcome(documents={FINDINGS: {"case_alarm": CASE_ALARM, "cases": described}})


def _findings(job: Job, case: HardCase) -> list[Finding]:
    try:
        found = run_case(
            job.method,
            job.make(),
            job.material,
            case,
            job.seed,
            device=job.budget.device,
            alpha=CASE_ALARM,
        )
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return [Finding("call", case.name, "fail", f"raised {text}")]
    return found or [Finding("call", case.name, "skip", "no property applies")]


def _described(
    case: HardCase, position: int, worst: Finding, findings: list[Finding]
) -> dict[str, Any]:
    return {
        "case": case.name,
        "group": case.group,
        "about": case.about,
        "position": position,
        "verdict": worst.verdict,
        "findings": [asdict(finding) for finding in findings],
    }
