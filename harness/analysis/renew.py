"""Records made again of stored raw data, where the analysis is another than it was."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from weakref import WeakKeyDictionary

from harness.analysis.records import registry
from harness.core.protocol.errors import InputError
from harness.core.record import Raw
from harness.identity.digests import Digests, Part
from harness.identity.ours import digests
from harness.identity.verdict import Verdict
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored

OUTDATED = Verdict(
    "stale",
    ("analysis",),
    "stale: the analysis changed, and the stored raw data do not hold what it needs now",
)
"""Of a trial whose records cannot be made anew."""


def analysis_digest(measure: str) -> str:
    """Of the code that makes the records of a measure; "" for one that gives them itself."""
    known = digests()
    found = _DIGESTS.setdefault(known, {})
    if measure not in found:
        found[measure] = _analysis_digest(known, measure)
    return found[measure]


def _analysis_digest(known: Digests, measure: str) -> str:
    file = registry.file_of(measure)
    if file is None:
        return ""
    entry = f"harness.analysis.records.{file.stem}:numbers"
    parts = {"analysis": Part((entry, "harness.analysis.process_pooling:pooled"))}
    return known.of(parts)["analysis"].digest


_DIGESTS: WeakKeyDictionary[Digests, dict[str, str]] = WeakKeyDictionary()
"""By measure, of each reading of the source tree: it is asked of every stored trial."""


def renew(results: ResultsFolder) -> int:
    """Bring the stored records up to date; how many trials that concerned. Measures nothing."""
    stored = results.trials()
    made = {key: renewed(trial) for key, trial in stored.items()}
    changed = {key: trial for key, trial in made.items() if trial is not stored[key]}
    if changed:
        results.save_records(changed)
    return len(changed)


def renewed(trial: Stored) -> Stored:
    """The trial with the records that today's analysis makes of its raw data.

    The same object where they are up to date, or where the raw data of an earlier version do not
    hold what today's analysis needs: then the records stay as they were made, and are
    :func:`outdated`.
    """
    if not outdated(trial) or trial.status not in ("ok", "nonfinite"):
        return trial
    measure = str(trial.labels["measure"])
    settings = (trial.trial.get("measure") or {}).get("settings") or {}
    try:
        numbers = registry.numbers(measure, Raw(trial.arrays, trial.documents, settings))
    except InputError:
        raise
    except ValueError:
        return trial
    assert numbers is not None  # a measure with a digest has a file
    bad = [f"{r.metric} is nan" for r in numbers.records if math.isnan(r.value)]
    return replace(
        trial,
        records=[asdict(record) for record in numbers.records],
        status="nonfinite" if bad else "ok",
        reason=", ".join(bad) or numbers.reason,
        analysis=analysis_digest(measure),
    )


def outdated(trial: Stored) -> bool:
    """Whether the records of a trial are of another analysis than today's."""
    now = analysis_digest(str(trial.labels.get("measure", "")))
    return bool(now) and bool(trial.analysis) and trial.analysis != now
