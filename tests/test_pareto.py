"""Fronts of uncertain points, families of methods, and the figures made of both."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import matplotlib.text
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from harness.analysis.combine import Estimate
from harness.analysis.families import families
from harness.analysis.front import standings
from harness.analysis.pareto import sampling_time
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas
from harness.report.figures.knob_path import inserted
from harness.report.figures.labels import Label, place
from harness.report.series.pareto import panels as panels_of
from harness.store.folder import ResultsFolder
from tests import report_results
from tests.report_results import Made

# The package has the figure itself under the module's name.
drawing = import_module("harness.report.figures.pareto")
Z = 1.959963984540054


def known(x: float, y: float, spread: float = 0.0) -> tuple[Estimate, Estimate]:
    """A point with a log-normal interval of the same relative width on both axes."""
    if not spread:
        return Estimate(x), Estimate(y)
    low, high = math.exp(-Z * spread), math.exp(Z * spread)
    return Estimate(x, x * low, x * high), Estimate(y, y * low, y * high)


def places(points: list) -> list[str]:
    return [s.place for s in standings(points)]


# --- the front ---------------------------------------------------------------------------------


def test_front_without_intervals():
    points = [known(1, 4), known(2, 2), known(4, 1), known(2, 4), known(3, 3)]
    found = standings(points)
    # (2, 4) equals others on either axis: dominated, though on neither axis apart from all.
    assert [s.place for s in found] == ["front", "front", "front", "possibly", "surely"]
    assert [s.membership for s in found] == [1, 1, 1, 0, 0]


def test_overlap_makes_it_possible_only():
    apart, near = known(2.0, 2.0, 0.01), known(1.01, 1.01, 0.01)
    assert places([known(1, 1, 0.01), apart]) == ["front", "surely"]
    assert places([known(1, 1, 0.01), near]) == ["front", "possibly"]
    # One axis alone in doubt is doubt.
    x = Estimate(1.001, 0.98, 1.02)
    assert places([known(1, 1, 0.01), (x, Estimate(5.0, 4.9, 5.1))]) == ["front", "possibly"]


def test_equal_points_share_the_front():
    assert places([known(1, 1), known(1, 1)]) == ["front", "front"]


def test_membership_is_the_probability():
    """Of two points, one's chance is known: 1 - P(x0 < x1) P(y0 < y1)."""
    from scipy.stats import norm

    spread, shift = 0.1, 0.08
    near = known(math.exp(shift), math.exp(shift), spread)
    found = standings([known(1, 1, spread), near])
    better = norm.cdf(shift / (spread * math.sqrt(2)))
    expected = [1 - (1 - better) ** 2, 1 - better**2]
    # 2000 draws: five standard errors.
    for standing, p in zip(found, expected, strict=True):
        assert abs(standing.membership - p) < 5 * math.sqrt(p * (1 - p) / 2000)


def test_no_place_on_log_axes():
    for bad in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="positive and finite"):
            standings([known(1, 1), (Estimate(1.0), Estimate(bad))])
    assert standings([]) == []


number = st.floats(1e-3, 1e3)
spreads = st.floats(0, 0.5)


@settings(max_examples=50, deadline=None, derandomize=True, database=None)
@given(st.lists(st.tuples(number, number, spreads), min_size=1, max_size=12))
def test_rules_hold_pair_by_pair(drawn):
    """Against the definition, one pair at a time."""
    points = [known(*item) for item in drawn]
    found = standings(points)
    for i, (x, y) in enumerate(points):
        rivals = [p for j, p in enumerate(points) if j != i]
        beaten = any(
            rx.value <= x.value
            and ry.value <= y.value
            and (rx.value < x.value or ry.value < y.value)
            for rx, ry in rivals
        )
        top = [[(e.high if e.has_interval else e.value) for e in p] for p in rivals]
        bottom = [(e.low if e.has_interval else e.value) for e in (x, y)]
        sure = any(rx < bottom[0] and ry < bottom[1] for rx, ry in top)
        assert found[i].place == ("surely" if sure else "possibly" if beaten else "front")
        assert 0 <= found[i].membership <= 1
    assert any(s.place == "front" for s in found)


# --- families ----------------------------------------------------------------------------------

SWEPT = {  # label: (name, excess, nanoseconds), params, budget
    "neural-spline-flow bins=5": (("neural-spline-flow", 1.9, 210.0), {"bins": 5}, {}),
    "neural-spline-flow bins=10": (("neural-spline-flow", 1.55, 260.0), {"bins": 10}, {}),
    "neural-spline-flow bins=40": (("neural-spline-flow", 1.3, 520.0), {"bins": 40}, {}),
    "neural-spline-flow width=8": (("neural-spline-flow", 2.3, 170.0), {"width": 8}, {}),
    "neural-spline-flow budget.steps=100": (
        ("neural-spline-flow", 2.9, 331.0),
        {},
        {"steps": 100},
    ),
    "two-lobe lobes=1": (("two-lobe", 4.6, 126.0), {"lobes": 1}, {}),
    "two-lobe lobes=4": (("two-lobe", 2.5, 152.0), {"lobes": 4}, {}),
    "two-lobe lobes=8": (("two-lobe", 2.35, 190.0), {"lobes": 8}, {}),
    "two-lobe odd": (("two-lobe", 2.4, 195.0), {"lobes": 8, "width": 64}, {}),
    "histogram resolution=8": (("histogram", 9.0, 240.0), {"resolution": 8}, {}),
    "histogram resolution=64": (("histogram", 4.0, 700.0), {"resolution": 64}, {}),
}


@pytest.fixture
def swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Results:
    """Made-up results of a suite with sweeps."""
    every = {**report_results.METHODS, **{label: entry[0] for label, entry in SWEPT.items()}}
    del every["fan-baseline"]
    monkeypatch.setattr(report_results, "METHODS", every)
    made = Made(
        materials=["suede", "brushed-metal"],
        methods=list(every),
        measures=("fit", "pdf", "equal-time"),
    )
    folder = made.write(tmp_path / "results")
    with ResultsFolder(folder) as store:
        plan = store.plan()
    for row in plan["trials"]:
        _, params, budget = SWEPT.get(row["method"], (None, {}, {}))
        budget = {"steps": 300, **budget}
        row["identity"]["method"] |= {"params": params, "budget": budget}
    with ResultsFolder(folder, write=True) as store:
        store.write_plan({k: v for k, v in plan.items() if k != "trials"}, plan["trials"])
    return Results.load(folder)


def test_families(swept: Results):
    found = {f.base.label: f for f in families(swept)}
    flow = found["neural-spline-flow"]
    assert flow.short("neural-spline-flow") == "neural-spline-flow"
    assert flow.short("neural-spline-flow bins=5") == "bins=5"
    assert flow.turned["neural-spline-flow budget.steps=100"] == ("budget.steps", 100)
    assert flow.paths()[0] == [f"neural-spline-flow bins={k}" for k in (5, 10, 40)]
    # Two settings at once belong to no knob.
    assert "two-lobe odd" not in found["two-lobe"].turned
    assert found["two-lobe"].short("two-lobe odd") == "two-lobe odd"
    assert sum(len(f.members) for f in found.values()) == len(swept.methods)


def test_base_goes_where_the_way_is_shortest():
    route = [(1.0, 8.0), (2.0, 4.0), (8.0, 1.0)]
    assert inserted(route, (4.0, 2.0)) == [*route[:2], (4.0, 2.0), route[2]]
    assert inserted([], (4.0, 2.0)) == [(4.0, 2.0)]


# --- figures -----------------------------------------------------------------------------------


def test_three_figures(swept: Results, tmp_path: Path):
    drawn = drawing.pareto(swept, Canvas(tmp_path / "figures"))
    assert [d.png.stem for d in drawn] == ["pareto-sampling", "pareto-render", "pareto-fitting"]
    for figure in drawn:
        assert all(path.stat().st_size > 5000 for path in figure.files)
        assert "no room" not in figure.caption.lower() and "95%" in figure.caption
    assert "One fit each: intervals" in drawn[2].caption


def test_panels_are_what_is_recorded(swept: Results):
    chart = drawing.CHARTS[0]
    panels = panels_of(swept, chart, "studio-sphere")
    assert list(panels) == [drawing.ALL, "suede", "brushed-metal"]
    point = next(p for p in panels["suede"].points if p.label == "two-lobe lobes=4")
    assert point.y == swept.number("pdf", "chi2", "suede", "two-lobe lobes=4")
    each = [
        next(q for q in panels[m].points if q.label == point.label)
        for m in ("suede", "brushed-metal")
    ]
    mean = next(q for q in panels[drawing.ALL].points if q.label == point.label)
    assert mean.y.value == pytest.approx(math.sqrt(each[0].y.value * each[1].y.value))
    assert mean.x.value == pytest.approx(math.sqrt(each[0].x.value * each[1].x.value))
    expected = standings([(q.x, q.y) for q in panels["suede"].points])
    assert [q.standing for q in panels["suede"].points] == expected


def test_no_mean_where_no_method_is_on_every_material(swept: Results):
    whole = drawing.CHARTS[0]

    def half(results: Results, material: str, label: str, scene: str) -> Estimate | str:
        if label.startswith("two-lobe") == (material == "suede"):
            return whole.x(results, material, label, scene)
        return "not measured"

    panels = panels_of(swept, replace(whole, x=half), "studio-sphere")
    assert list(panels) == ["suede", "brushed-metal"]


def test_what_is_not_fitted_is_no_point(swept: Results):
    panel = panels_of(swept, drawing.CHARTS[2], "")["suede"]
    assert {p.label for p in panel.levels} == {"cosine", "native"}
    assert not {"cosine", "native"} & {p.label for p in panel.points}


def test_sampling_time_falls_back(swept: Results):
    """Without a measure of the sampler alone it is the rendered sample's."""
    time = sampling_time(swept, "suede", "cosine", "studio-sphere")
    assert isinstance(time, Estimate)
    assert time.value == pytest.approx(95, rel=0.05) and time.low < time.value < time.high


def test_nothing_to_draw(tmp_path: Path):
    folder = Made(measures=("fit",)).write(tmp_path / "r")
    said = drawing.pareto(Results.load(folder), Canvas(tmp_path / "figures"))
    assert isinstance(said, str) and "sampling" in said


def test_labels_keep_apart():
    """Of each other and of every marker, however the points crowd; lost ones are given back."""
    figure = Figure(figsize=(3.6, 3.2))
    axes = figure.subplots()
    axes.set_xscale("log")
    axes.set_yscale("log")
    random = np.random.default_rng(0)
    points = [(float(x), float(y)) for x, y in np.exp(random.standard_normal((40, 2)))]
    axes.set_xlim(0.05, 20)
    axes.set_ylim(0.05, 20)
    labels = [Label(x, y, f"resolution={i}", "black") for i, (x, y) in enumerate(points[:14])]
    figure.draw_without_rendering()
    lost = place(axes, labels, points)
    renderer = FigureCanvasAgg(figure).get_renderer()
    written = [t for t in axes.texts if isinstance(t, matplotlib.text.Annotation)]
    assert len(written) + len(lost) == 14 and len(written) >= 10
    for note in written:
        note.update_positions(renderer)
    boxes = [matplotlib.text.Text.get_window_extent(t, renderer) for t in written]
    inside = axes.get_window_extent(renderer)
    for i, box in enumerate(boxes):
        # Half a pixel: the renderer rounds the place of text.
        assert box.x0 > inside.x0 - 0.5 and box.x1 < inside.x1 + 0.5
        small = box.padded(-0.5)
        assert not any(small.overlaps(other) for other in boxes[:i])
        for point in points:
            assert not small.contains(*axes.transData.transform(point))
    crowd = [Label(1.0, 1.0, "a label far too long for a panel of this size " * 3, "black")]
    assert place(axes, crowd, points) == crowd
