"""A suite reduced to what its scenes' effects cost and change."""

from __future__ import annotations

from dataclasses import replace

from harness.core.protocol.errors import InputError, nearest
from harness.suite.load import Loaded
from harness.suite.plan import DEFAULT_BASELINE
from harness.suite.schema import MeasureSpec, ReportSpec

MEASURE = "effects"


def effects_only(loaded: Loaded, method: str | None) -> Loaded:
    """The suite with the measure ``effects`` alone, with its settings where it has them.

    One method renders: ``method``, or the suite's baseline, for effects are the scene's.
    """
    suite = loaded.suite
    if not suite.scenes:
        raise InputError(f"{loaded.path}: scenes: expected at least one, whose effects to measure")
    labels = [spec.label for spec in suite.methods]
    usual = DEFAULT_BASELINE if DEFAULT_BASELINE in labels else labels[0]
    chosen = method or suite.baseline or usual
    if chosen not in labels:
        raise InputError(f"--method {chosen}: no method of {loaded.path}{nearest(chosen, labels)}")
    measures = [m for m in suite.measures if m.name == MEASURE] or [MeasureSpec(name=MEASURE)]
    profiles = {
        name: p.model_copy(
            update={
                "methods": None,
                "override": {k: v for k, v in p.override.items() if k == chosen},
                "measures": {k: v for k, v in p.measures.items() if k == MEASURE},
            }
        )
        for name, p in suite.profiles.items()
    }
    reduced = suite.model_copy(
        update={
            "measures": measures,
            "methods": [spec for spec in suite.methods if spec.label == chosen],
            "baseline": chosen,
            "profiles": profiles,
            "report": ReportSpec(tables=[MEASURE, "effect-counts", "status"], figures=[MEASURE]),
        }
    )
    return replace(loaded, suite=reduced)
