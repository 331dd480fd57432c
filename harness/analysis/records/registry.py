"""Makes the records of a trial from its raw data: one file of this folder per measure.

A file has ``numbers(raw: Raw) -> Numbers``, a pure function. One of a timing that may be
repeated in fresh processes names in ``OWN_TIMES`` the metrics that say how well the baseline was
timed, whose ratios are 1 by definition.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

from harness.analysis import process_pooling
from harness.core.record import Numbers, Raw

RECORDS = Path(__file__).parent
_OTHERS = ("__init__", "registry")


def names() -> list[str]:
    """Measures whose records are made here, sorted."""
    stems = (file.stem for file in RECORDS.glob("*.py"))
    return sorted(stem.replace("_", "-") for stem in stems if stem not in _OTHERS)


def file_of(measure: str) -> Path | None:
    """The file that makes a measure's records; None for a measure that gives them itself."""
    return RECORDS / f"{measure.replace('-', '_')}.py" if measure in names() else None


def numbers(measure: str, raw: Raw) -> Numbers | None:
    """The records of one trial; None for a measure that has no file here.

    Raises:
        ValueError: an array or document is missing, as in a store of an older format.
    """
    file = file_of(measure)
    if file is None:
        return None
    module = import_module(f"harness.analysis.records.{file.stem}")
    try:
        parts = process_pooling.split(raw)
        if parts is None:
            return module.numbers(raw)
        return _pooled(module, raw, parts)
    except KeyError as error:
        raise ValueError(f"{measure}: the raw data hold no {error}") from error


def _pooled(module: ModuleType, raw: Raw, parts: list[Raw]) -> Numbers:
    return process_pooling.pooled(
        [module.numbers(part) for part in parts],
        tolerance=float(raw.settings["tolerance"]),
        own_times=getattr(module, "OWN_TIMES", ()),
    )
