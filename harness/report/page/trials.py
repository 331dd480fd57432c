"""Every trial as plain data: what was run, its numbers, machine and log, and how to repeat it."""

from __future__ import annotations

import json
import shlex
from typing import Any

from harness.analysis.results import Results
from harness.report.page.names import Names
from harness.report.page.plain import number
from harness.store.stored import STATE, Stored


class _Shared:
    """Plain data that many trials share, each kept once."""

    def __init__(self) -> None:
        self.kept: list[Any] = []
        self._places: dict[str, int] = {}

    def place(self, data: Any) -> int:
        text = json.dumps(data, sort_keys=True, default=str)
        if text not in self._places:
            self._places[text] = len(self.kept)
            self.kept.append(json.loads(text))
        return self._places[text]


def trials(results: Results) -> dict[str, Any]:
    """``list`` has a trial each, in the plan's order; its short keys are told in docs/report.md."""
    names = Names(results)
    shared, metrics, units = _Shared(), _Shared(), _Shared()
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in results.frame.to_dict("records"):
        rows.setdefault(row["trial"], []).append(row)
    made = []
    for key in names.trials:
        first, stored = rows[key][0], results.stored(key)
        failed = next((row for row in rows[key] if row["status"] != "ok"), first)
        entry = {
            "key": key,
            "m": names.materials.index(first["material"]),
            "d": names.methods.index(first["method"]),
            "c": names.scenes.index(first["scene"]) if first["scene"] else -1,
            "e": names.measures.index(first["measure"]),
            "seed": int(first["seed"]),
            "training": int(results.training.get(key, first["seed"])),
            "status": failed["status"],
            "reason": shared.place(failed["reason"]) if failed["reason"] else -1,
            "records": [
                [
                    metrics.place(row["metric"]),
                    *(number(row[end]) for end in ("value", "ci_low", "ci_high")),
                    units.place(row["unit"]),
                ]
                for row in rows[key]
                if row["metric"]
            ],
        }
        made.append(entry | _stored(stored, shared, names))
    return {"list": made, "shared": shared.kept, "metrics": metrics.kept, "units": units.kept}


def _stored(stored: Stored, shared: _Shared, names: Names) -> dict[str, Any]:
    """What is stored with a trial beside its numbers."""
    found: dict[str, Any] = {
        "about": {key: shared.place(value) for key, value in stored.trial.items()},
        "environment": shared.place(stored.environment),
        "arrays": shared.place(sorted(stored.kept_arrays)),
        "files": shared.place(sorted(stored.files)),
    }
    if stored.started:
        found |= {"started": stored.started, "seconds": number(stored.seconds, 3)}
    if stored.fit in names.trials:
        found["fit"] = names.trials[stored.fit]
    for key, value in (
        ("shipped", stored.shipped), ("log", stored.traceback), ("effects", stored.effects),
    ):  # fmt: skip
        if value:
            found[key] = shared.place(value)
    if stored.documents:
        found["documents"] = shared.place(sorted(stored.documents))
    if STATE in stored.files or stored.state:
        found["state"] = stored.state or stored.files[STATE]
    return found


def command(results: Results) -> str:
    """What runs a part of the suite anew, up to its labels."""
    name = str(results.plan.get("suite") or results.folder.name)
    profile = f" --profile {shlex.quote(results.profile)}" if results.profile else ""
    device = str(results.plan.get("device") or "cpu")
    profile += f" --device {device}" if device != "cpu" else ""
    return f"harness run {shlex.quote(f'suites/{name}.yaml')}{profile}"
