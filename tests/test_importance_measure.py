"""The measure of importance maps, and the table and figure of what it stores."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from harness.analysis.results import Results
from harness.cli.main import main
from harness.report.figures.canvas import Canvas
from harness.report.parts import part
from harness.report.tables.importance_maps import LOBES


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    folder: Path = tmp_path_factory.mktemp("maps")
    suite = {
        "name": "maps",
        "materials": ["disney"],
        "methods": [
            {"name": "importance-baked", "label": kind, "params": {"kind": kind, "slices": 16}}
            for kind in ("row-column", "optimal-transport")
        ]
        + ["cosine"],
        "baseline": "row-column",
        "budget": {"steps": 0},
        "measures": [
            {
                "name": "importance-maps",
                "count": 4,
                "slice_resolution": 32,
                "resolutions": [8, 16],
                "bins": 16,
                "side": 128,
                "shown": 1,
            }
        ],
        "report": {"tables": [], "figures": []},
    }
    (folder / "maps.yaml").write_text(yaml.safe_dump(suite))
    assert main(["run", str(folder / "maps.yaml"), "--out", str(folder / "out")]) == 0
    return Results.load(folder / "out")


def test_records(results):
    """Finer maps err less; transport costs least; a method without maps is unsupported."""
    frame = results.frame[results.frame.measure == "importance-maps"]
    value = frame[frame.status == "ok"].set_index(["method", "metric"]).value
    for kind in ("row-column", "optimal-transport"):
        assert value[kind, "binned-error-16"] < value[kind, "binned-error-8"] < 1
        assert 0 < value[kind, "gradient-mean-16"] < value[kind, "gradient-p99-16"]
    assert value["optimal-transport", "cost-16"] < value["row-column", "cost-16"]
    other = frame[frame.method == "cosine"].iloc[0]
    assert other.status == "unsupported" and "bakes no importance maps" in other.reason


def test_same_slices_for_all_kinds(results):
    one, other = (
        results.arrays(results.trials("importance-maps", "disney", kind)[0])
        for kind in ("row-column", "optimal-transport")
    )
    assert np.array_equal(one["spread"], other["spread"])
    assert np.array_equal(one["condition"], other["condition"])
    assert not np.array_equal(one["map"], other["map"])


def test_table_and_figure(results, tmp_path):
    table = part("tables", "importance-maps")(results)
    assert list(table.columns) == ["row-column", "optimal-transport", "cosine"]
    arrays = results.arrays(results.trials("importance-maps")[0])
    ratios = [s for s in table.sections if s.title.endswith("over row-column")]
    assert len(ratios) == len(table.sections) / 2
    cost = next(s for s in ratios if s.title.startswith("transport cost"))
    assert all(r.cells[0].value == 1 and r.cells[1].value < 1 for r in cost.rows)
    for section in table.sections:
        counts = [int(row.label.split("(")[1].rstrip(")")) for row in section.rows]
        assert sum(counts) == len(arrays["spread"]) and len(counts) <= len(LOBES)
        assert all(cell.missing for row in section.rows for cell in row.cells[2:])
    (drawn,) = part("figures", "importance-maps")(results, Canvas(tmp_path))
    assert drawn.png.stat().st_size > 5000
