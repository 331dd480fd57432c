"""What each effect of a scene costs and changes, and whether the scene needs it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from harness.analysis.effects import MEASURE, Rows, effects_of, trials, verdict
from harness.analysis.results import Results
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import circumstances

ORDER = 140
_SHADES = ("degraded", "pass", "fail", "pass")
ONLY_LIGHT = "the only light: without it nothing is rendered"


def effects(results: Results) -> Table | str:
    """A section per scene, material and method; a row per effect, in order of decreasing cost."""
    found = trials(results)
    if not found:
        return f"no trial of the measure {MEASURE} is stored"
    columns = ["verdict", "adds ms/spp", "share", "relMSE", "of noise", "FLIP", "of noise"]
    sections = effect_sections(results, found, columns, _row)
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
        measures=(MEASURE,),
    )


def effect_sections(
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


def _row(rows: Rows, name: str) -> Row:
    seconds, own = rows.get(f"{name}.seconds"), rows["seconds-per-spp"]["value"]
    cells = [_verdict(rows, name)]
    if seconds is None:
        cells += [Cell(missing=ONLY_LIGHT)] * 2
    else:
        value, low, high = (1e3 * seconds[k] for k in ("value", "ci_low", "ci_high"))
        cells += [Cell(value, low, high), _percent(seconds["value"] / own)]
    change = rows[f"{name}.relmse"]
    cells.append(_interval(change))
    cells += [Cell(rows["noise"]["value"]), Cell(rows[f"{name}.flip"]["value"])]
    cells.append(Cell(rows["flip-noise"]["value"]))
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
