"""What each effect of a scene costs and changes, and whether the scene needs it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from harness.analysis.results import Results
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import circumstances

MEASURE = "effects"
VERDICTS = ("negligible", "needed", "missing", "not needed")
"""By the number that the measure records."""
_SHADES = ("degraded", "pass", "fail", "pass")
_COUNTS = {
    "rays": "rays",
    "shadow-rays": "shadow rays",
    "evaluations": "evaluations",
    "values": "values",
    "pdf-queries": "pdf queries",
    "network": "networks",
}
_ONLY_LIGHT = "the only light: without it nothing is rendered"

Rows = dict[str, dict[str, Any]]
"""One trial's rows by metric."""


def effects(results: Results) -> Table | str:
    """A section per scene, material and method; a row per effect, dearest first."""
    found = trials(results)
    if not found:
        return f"no trial of the measure {MEASURE} is stored"
    columns = ["verdict", "adds ms/spp", "share", "relMSE", "of noise", "FLIP", "of noise"]
    sections = _sections(results, found, columns, _row)
    tolerance = next((rows["tolerance"]["value"] for rows in found.values() if rows), math.nan)
    return Table(
        name=MEASURE,
        title="Effects",
        caption=(
            "Each effect that a scene calls for, against the scene without it; and each that it "
            "could have and does not call for. Needed: the root of the relMSE that leaving it out "
            f"makes is above {tolerance:g}, beyond noise; negligible: it is not, so its cost buys "
            "nothing; missing: the scene does not call for it, and it changes as much. Light "
            "sampling is needed if it lowers (variance × time). relMSE and FLIP are of the image "
            "without the effect, beside those of two images that have half of the samples each. "
            + circumstances(results, MEASURE, timed=True)
        ).strip(),
        corner="effect",
        columns=columns,
        sections=sections,
        legend=choices(results),
    )


def effect_counts(results: Results) -> Table | str:
    """What each effect has the renderer do, in the same sections and rows."""
    found = trials(results)
    if not found:
        return f"no trial of the measure {MEASURE} is stored"
    columns = list(_COUNTS.values())
    return Table(
        name="effect-counts",
        title="What runs for each effect",
        caption=(
            "How many more, for each sample of a pixel, with the effect than without it: rays that "
            "go on from a surface, rays to a sampled light, evaluations of BSDFs, numbers that "
            "these gave, pdf queries, and evaluations of neural networks; over all surfaces. "
            + circumstances(results, MEASURE)
        ).strip(),
        corner="effect",
        columns=columns,
        sections=_sections(results, found, columns, _counts),
    )


def _sections(
    results: Results,
    found: dict[tuple[str, str, str], Rows],
    columns: list[str],
    row: Callable[[Rows, str], Row],
) -> list[Section]:
    """One per trial; a trial that failed says why."""
    sections = []
    for (scene, material, method), rows in found.items():
        title = f"{scene}, {material}, {method}"
        if effects_of(rows):
            sections.append(Section(title, [row(rows, name) for name in effects_of(rows)]))
        else:
            why = results.why_missing(MEASURE, material, method, scene)
            sections.append(Section(title, [Row("†", [Cell(missing=why) for _ in columns])]))
    return sections


def choices(results: Results) -> list[str]:
    """What ``auto`` came to in each scene for each material, and why, in sentences."""
    said = []
    for scene, material, method in trials(results):
        for trial in results.trials(MEASURE, material, method, scene)[:1]:
            chosen = results.stored(trial).effects
            if chosen:
                why = "; ".join(f"{name}: {reason}" for name, reason in chosen["why"].items())
                listed = ", ".join(chosen["chosen"])
                said.append(f"{scene}, {material}: auto chose {listed}. {why}.")
    return said


def trials(results: Results) -> dict[tuple[str, str, str], Rows]:
    """(scene, material, method) -> rows of its first trial by metric; none where it failed."""
    found: dict[tuple[str, str, str], Rows] = {}
    for row in results.rows(MEASURE):
        rows = found.setdefault((row["scene"], row["material"], row["method"]), {})
        if row["status"] == "ok":
            rows.setdefault(row["metric"], row)
    return found


def effects_of(rows: Rows) -> list[str]:
    """Names of the effects with a verdict: those called for first, each kind dearest first."""
    names = [m.removesuffix(".verdict") for m in rows if m.endswith(".verdict")]

    def order(name: str) -> tuple[bool, float]:
        seconds = rows.get(f"{name}.seconds")
        return verdict(rows, name) in VERDICTS[2:], -(seconds["value"] if seconds else math.inf)

    return sorted(names, key=order)


def verdict(rows: Rows, name: str) -> str:
    """In a word."""
    return VERDICTS[int(rows[f"{name}.verdict"]["value"])]


def _row(rows: Rows, name: str) -> Row:
    seconds, own = rows.get(f"{name}.seconds"), rows["seconds-per-spp"]["value"]
    cells = [_verdict(rows, name)]
    if seconds is None:
        cells += [Cell(missing=_ONLY_LIGHT)] * 2
    else:
        value, low, high = (1e3 * seconds[k] for k in ("value", "ci_low", "ci_high"))
        cells += [Cell(value, low, high), _percent(seconds["value"] / own)]
    change = rows[f"{name}.relmse"]
    cells.append(_interval(change))
    cells += [Cell(rows["noise"]["value"]), Cell(rows[f"{name}.flip"]["value"])]
    cells.append(Cell(rows["flip-noise"]["value"]))
    return Row(name, cells)


def _counts(rows: Rows, name: str) -> Row:
    cells = []
    for kind in _COUNTS:
        count = rows.get(f"{name}.{kind}")
        if count is None:
            cells.append(Cell(missing=_ONLY_LIGHT))
        else:
            # A count of a few samples; its third digit is chance.
            value = round(count["value"], 2) + 0.0
            cells.append(Cell(count["value"], text=f"{value:g}"))
    return Row(name, cells)


def _verdict(rows: Rows, name: str) -> Cell:
    word = verdict(rows, name)
    warning = ""
    if rows.get(f"{name}.unclear", {}).get("value"):
        warning = "unclear: noise reaches to the other side; more rounds would tell"
    gain = rows.get(f"{name}.gain")
    text = word if gain is None else f"{word}, {gain['value']:.2g}× as fast with it"
    code = int(rows[f"{name}.verdict"]["value"])
    return Cell(float(code), text=text, warning=warning, shade=_SHADES[code])


def _interval(row: dict[str, Any]) -> Cell:
    if math.isnan(row["ci_low"]) or row["ci_low"] == row["ci_high"]:
        return Cell(row["value"])
    return Cell(row["value"], row["ci_low"], row["ci_high"])


def _percent(share: float) -> Cell:
    return Cell(share, text=f"{share:+.0%}")
