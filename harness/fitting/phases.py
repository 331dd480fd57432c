"""Fits in several phases."""

from __future__ import annotations

from harness.core.protocol.method import FitReport


def joined(reports: list[FitReport], phases: list[str]) -> FitReport:
    """One report of all phases."""
    whole = FitReport(
        steps=sum(r.steps for r in reports),
        parameters=reports[-1].parameters,
        data_seconds=reports[0].data_seconds,
        optimise_seconds=sum(r.optimise_seconds for r in reports),
        loss=[value for r in reports for value in r.loss],
        part_seconds=reports[0].part_seconds if len(reports) == 1 else [],
    )
    spent = [f"{p} {r.optimise_seconds:.1f} s" for p, r in zip(phases, reports, strict=True)]
    notes = [", ".join(spent)] if len(reports) > 1 else []
    whole.notes = "; ".join([*notes, *filter(None, [reports[0].notes])])
    return whole
