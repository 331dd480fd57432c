"""The trials that gave no number, and why; what methods did that they should not; materials that
have yet to be made."""

from __future__ import annotations

from harness.analysis.results import Results
from harness.analysis.validity import in_few_words
from harness.report.table import Cell, Row, Section, Table
from harness.store.frame import STALE
from harness.store.stored import NOT_RUN

ORDER = 160
_COLUMNS = ("method", "measure", "status", "reason")


def status(results: Results) -> Table | str:
    """A row for each failure of a method; what failed alike shares one."""
    failed = results.frame[results.frame["status"] != "ok"].drop_duplicates("trial")
    # An interrupted run leaves hundreds of these; their number says it all.
    waiting = (failed["status"] == "skipped") & (failed["reason"] == NOT_RUN)
    alike: dict[tuple[str, str, str], list[dict]] = {}
    for row in failed[~waiting].to_dict("records"):
        reason = " ".join(str(row["reason"]).split()) or "no reason stored"
        if row["status"] == STALE:
            reason = in_few_words(reason)
        alike.setdefault((row["method"], row["status"], reason), []).append(row)
    for row in results.frame.drop_duplicates("trial").to_dict("records"):
        stored = results.found.get(row["trial"])
        for finding in stored.findings if stored else ():
            alike.setdefault((row["method"], "finding", finding), []).append(row)
    rows = []
    for (method, state, reason), members in alike.items():
        words = (method, _places(members, results), state, reason)
        rows.append(Row(_materials(members, results), [Cell(text=word) for word in words]))
    for name, command in (results.plan.get("left_out") or {}).items():
        if name in results.plan.get("materials", ()):
            continue  # merged with results that have it
        rows.append(
            Row(
                name,
                [Cell(text=word) for word in (" ", " ", "left out", f"not made yet: {command}")],
            )
        )
    trials = results.frame["trial"].nunique()
    counts = failed.loc[~waiting, "status"].value_counts().to_dict()
    said = [f"{trials} trials planned", f"{trials - len(failed)} ok"]
    said += [f"{count} {name}" for name, count in counts.items()]
    if waiting.any():
        said.append(f"{waiting.sum()} {NOT_RUN}")
    return Table(
        name="status",
        title=_title(set(failed["status"])),
        caption=f"{', '.join(said)}.",
        corner="material",
        columns=list(_COLUMNS),
        sections=[Section("", rows)] if rows else [],
        text_columns=True,
    )


def _title(states: set[str]) -> str:
    lost = "Trials without a number" if states - {STALE} else ""
    if STALE not in states:
        return lost or "All trials gave their numbers"
    return f"{lost}, or with one that is stale" if lost else "Trials whose numbers are stale"


def _materials(rows: list[dict], results: Results) -> str:
    names = list(dict.fromkeys(row["material"] for row in rows))
    if len(names) == len(results.materials) > 2:
        return f"all {len(names)}"
    return ", ".join(names)


def _places(rows: list[dict], results: Results) -> str:
    """The measures that failed, with scene and seed where there are several of those."""
    several_scenes = results.frame["scene"].nunique() > 2  # "" is one of them
    several_seeds = results.frame["seed"].nunique() > 1
    places = []
    for row in rows:
        where = [row["scene"]] if several_scenes and row["scene"] else []
        where += [f"seed {row['seed']}"] if several_seeds else []
        places.append(row["measure"] + (f" ({', '.join(where)})" if where else ""))
    return ", ".join(dict.fromkeys(places))
