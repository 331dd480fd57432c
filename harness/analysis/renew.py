"""Records made again of stored raw data, where the analysis is another than it was."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

from harness.analysis.records import registry
from harness.core.record import Raw
from harness.identity.digests import Part
from harness.identity.ours import digests
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored


def analysis_digest(measure: str) -> str:
    """Of the code that makes the records of a measure; "" for one that gives them itself."""
    file = registry.file_of(measure)
    if file is None:
        return ""
    entry = f"harness.analysis.records.{file.stem}:numbers"
    parts = {"analysis": Part((entry, "harness.analysis.process_pooling:pooled"))}
    return digests().of(parts)["analysis"].digest


def renew(results: ResultsFolder) -> int:
    """Bring the stored records up to date; how many trials that concerned. Measures nothing."""
    count = 0
    for key, trial in results.trials().items():
        found = renewed(trial)
        if found is not trial:
            results.save_records(key, found)
            count += 1
    return count


def renewed(trial: Stored) -> Stored:
    """The trial with the records that today's analysis makes of its raw data.

    The same object where they are up to date, or where the raw data of an earlier version do not
    hold what today's analysis needs: then the records stay as they were made.
    """
    measure = str(trial.labels.get("measure", ""))
    now = analysis_digest(measure)
    if not now or not trial.analysis or trial.analysis == now:
        return trial
    if trial.status not in ("ok", "nonfinite"):
        return trial
    settings = (trial.trial.get("measure") or {}).get("settings") or {}
    numbers = registry.numbers(measure, Raw(trial.arrays, trial.documents, settings))
    assert numbers is not None  # a measure with a digest has a file
    bad = [f"{r.metric} is nan" for r in numbers.records if math.isnan(r.value)]
    return replace(
        trial,
        records=[asdict(record) for record in numbers.records],
        status="nonfinite" if bad else "ok",
        reason=", ".join(bad) or numbers.reason,
        analysis=now,
    )
