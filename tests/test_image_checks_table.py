"""The table of image checks, of made-up records."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from harness.analysis.results import Results
from harness.report.table import Table
from harness.report.tables.image_checks import CHECKS, NOISELESS, image_checks


def table(rows: list[dict[str, Any]]) -> Table | str:
    """Of stored records."""
    import pandas as pd

    columns = {"suite": "s", "scene": "studio-sphere", "measure": "image-checks", "seed": 0}
    columns |= {"ci_low": math.nan, "ci_high": math.nan, "unit": "1", "status": "ok", "reason": ""}
    full = [{**columns, "trial": f"{row['material']}-{row['method']}", **row} for row in rows]
    plan = {
        "trials": [
            {"method": m, "identity": {"method": {"name": m}}}
            for m in dict.fromkeys(row["method"] for row in rows)
        ]
    }
    return image_checks(Results(Path(), pd.DataFrame(full), plan, {}))


def test_table():
    """p-values corrected over the whole table, a mark where one is small, ratios, daggers."""
    rows = []
    for method, p in (("right", 0.02), ("wrong", 1e-9)):
        at = {"material": "suede", "method": method}
        rows += [{**at, "metric": f"{c}-p", "value": p} for c in CHECKS]
        rows += [{**at, "metric": c, "value": -0.05} for c in CHECKS]
        rows.append({**at, "metric": "mis-variance", "value": 2.0, "ci_low": 1.9, "ci_high": 2.1})
    rows.append(
        {
            "material": "suede",
            "method": "lost",
            "metric": "",
            "value": math.nan,
            "status": "timeout",
            "reason": "slow",
        }
    )
    made = table(rows)
    assert isinstance(made, Table) and made.columns == ["right", "wrong", "lost"]
    (section,) = made.sections
    assert section.title == "studio-sphere, suede" and len(section.rows) == 9
    right, wrong, lost = section.rows[0].cells
    # Six of the twelve are smaller: the others count six times.
    assert right.value == pytest.approx(0.12) and not right.warning
    assert wrong.value == pytest.approx(1.2e-8) and "wrong on suede, furnace" in wrong.warning
    assert "-5.00%" in wrong.warning and lost.missing == "timeout: slow"
    ratio, missing = section.rows[6].cells[0], section.rows[7].cells[0]
    assert (ratio.value, ratio.low, ratio.high, ratio.suffix) == (2.0, 1.9, 2.1, "×")
    assert missing.missing == NOISELESS
    assert "6 of 12" in made.caption


def test_no_table():
    """Of a suite without the measure."""
    row = {"material": "suede", "method": "cosine", "metric": "kl", "value": 1.0, "measure": "pdf"}
    assert table([row]) == "no trial of the measure image-checks is stored"
