"""The hard cases of the catalogue that a material stands for, with a verdict on each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from pydantic import field_validator
from pydantic_core import PydanticCustomError

from harness.checks.catalogue import CATALOGUE, HardCase
from harness.checks.finding import Finding, verdict
from harness.checks.run import CASE_ALARM, run_case
from harness.core.jsonfile import write_json
from harness.core.protocol.errors import Unsupported, nearest
from harness.core.record import Record
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings

FINDINGS = "findings.json"
LEVELS = {"pass": 0.0, "degraded": 1.0, "fail": 2.0}
"""What is recorded for a verdict. A case that was skipped has no number, only its reason."""

NUMBERS: dict[str, tuple[str, Callable[..., float]]] = {
    "weights": ("efficiency", min),
    "coverage": ("lost", max),
    "tail-index": ("tail-index", min),
    "largest-weight": ("largest-weight", max),
    "invalid": ("invalid", max),
}
"""Property -> (metric, which of several conditions' numbers is the worst)."""


class Stability(Measure):
    """A verdict on each hard case of the catalogue that is about the job's material.

    For each case the metric CASE, 0 for pass, 1 for degraded, 2 for fail; and the numbers
    CASE/efficiency, CASE/lost, CASE/tail-index, CASE/largest-weight, CASE/invalid where a
    property measured them, the worst over the case's conditions. All findings, with the worst
    inputs, go to ``findings.json``. An adapter that raises has failed that case, and the
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
        records, described = [], []
        for case in chosen:
            findings = _findings(job, case)
            worst = verdict(findings)
            records += _records(case.name, worst, findings)
            described.append(_described(case, places[case.name], worst, findings))
        write_json(job.out_dir / FINDINGS, {"case_alarm": CASE_ALARM, "cases": described})
        return Outcome(records=records)


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


def _records(case: str, worst: Finding, findings: list[Finding]) -> list[Record]:
    records = []
    if worst.verdict in LEVELS:
        records.append(Record(case, LEVELS[worst.verdict], unit="verdict"))
    for name, (metric, of_several) in NUMBERS.items():
        found = [f for f in findings if f.property == name and f.number is not None]
        # A nan measures nothing: the finding fails, and that is recorded.
        values = [f.number for f in found if not math.isnan(f.number)]
        if values:
            records.append(Record(f"{case}/{metric}", of_several(values), unit=found[0].unit))
    return records


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
