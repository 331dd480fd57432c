"""Figures: what is drawn, what is left out and why."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.lines import Line2D

from harness.analysis.combine import Estimate
from harness.analysis.quantities import nanoseconds_per_sample
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.canvas import Canvas
from harness.report.figures.palette import looks
from harness.report.figures.rendered import exposure, reference, srgb
from harness.report.figures.small_multiples import Labels, panels
from harness.report.figures.style import styled
from harness.report.figures.tradeoff import Point, _front
from harness.report.parts import part, parts
from harness.report.series.shots import telling_squares, worst_square
from tests.report_reading import cell_of
from tests.report_results import MATERIALS, METHODS, Made

# --- figures -------------------------------------------------------------------------------------


def test_front_keeps_what_nothing_beats():
    def point(time: float, error: float) -> Point:
        return Point(MethodColumn("m", "m"), Estimate(time), Estimate(error))

    points = [point(1, 5), point(2, 6), point(3, 2), point(3, 1), point(9, 1)]
    assert _front(points) == [points[0], points[3]]


def test_looks_are_fixed_and_distinct(failing: Path, tmp_path: Path):
    few = looks(Results.load(failing))
    many = looks(
        Results.load(Made(methods=[*METHODS, "mine", "theirs"], measures=("pdf",)).write(tmp_path))
    )
    assert all(many[label] == look for label, look in few.items() if label != "fan-baseline")
    assert len({(x.colour, x.marker) for x in many.values()}) == len(many)
    assert len({x.colour for x in many.values()}) == len(many)


def test_image_helpers():
    image = np.full((32, 32, 3), 0.25)
    assert srgb(image, 4.0).max() == pytest.approx(1.0)
    assert exposure(image) == pytest.approx(4.0)
    noisy = image.copy()
    noisy[20:26, 4:10] += 1.0
    found = worst_square([noisy, image], image, None)
    assert found.row <= 20 and found.row + 8 >= 26
    assert found.column <= 4 and found.column + 8 >= 10
    noisy[0:6, 20:26] += 0.5
    elsewhere = np.zeros((32, 32), bool)
    elsewhere[:12] = True
    found = worst_square([noisy, image], image, elsewhere)
    assert found.row == 0 and found.column <= 20 and found.column + 8 >= 26


def test_squares_are_where_methods_differ_not_where_all_are_wrong():
    image = np.full((32, 32, 3), 0.25)
    one, other = image.copy(), image.copy()
    one[0:8, 0:8] += 1.0
    other[0:8, 0:8] += 1.0  # both are as wrong there
    other[20:26, 20:26] += 0.3
    first, *others = telling_squares([one, other], image, None)
    assert first.row <= 20 and first.row + 8 >= 26
    assert first.column <= 20 and first.column + 8 >= 26
    for square in others:
        assert abs(square.row - first.row) > 8 or abs(square.column - first.column) > 8
    assert telling_squares([image, image], image, None) == []


def test_thumbnails_are_of_the_materials_that_were_rendered(tmp_path: Path):
    """One sheet a scene; a biased method has no part in them."""
    made = Made(materials=MATERIALS[:7], bias={("cosine", MATERIALS[0]): 1e-9})
    results = Results.load(made.write(tmp_path))
    (sheet,) = part("figures", "materials")(results, Canvas(tmp_path))
    assert sheet.png.name == "materials-studio-sphere.png" and sheet.width == 6 * 165
    at = (MATERIALS[0], "cosine", "studio-sphere")
    before = reference(results, MATERIALS[0], "studio-sphere")
    results.stored(results.trials("equal-spp", *at)[0]).images["mean"][:] = 1e6
    np.testing.assert_array_equal(reference(results, MATERIALS[0], "studio-sphere"), before)


def test_images_of_another_size_are_no_reference(tmp_path: Path):
    """Equal samples at half the size: the figure is drawn, without the reference it would have."""
    results = Results.load(Made(materials=MATERIALS[:1]).write(tmp_path))
    for trial in results.trials("equal-spp"):
        images = results.stored(trial).images
        images["mean"] = images["mean"][::2, ::2]
    assert reference(results, MATERIALS[0], "studio-sphere").shape == (16, 16, 3)
    drawn = part("figures", "images")(results, Canvas(tmp_path))
    assert [each.png.name for each in drawn][:1] == ["images-studio-sphere.png"]


def rows_of(count: int) -> list[int]:
    """How many of ``count`` panels stand in each row, from above."""
    stacks = [[Labels("x", "y", str(n))] for n in range(count)]
    figure, grid = panels(stacks, (1.0, 0.5), [Line2D([], [], label="a")])
    boxes = [axes.get_position() for (axes,) in grid]
    inches = np.array([box.size for box in boxes]) * figure.get_size_inches()
    np.testing.assert_allclose(inches, np.full((count, 2), [1.0, 0.5]))
    tops = [round(box.y1, 6) for box in boxes]
    return [tops.count(top) for top in sorted(set(tops), reverse=True)]


def test_a_legend_has_room_beside_a_single_panel():
    """Its longest label is longer than a panel is wide."""
    label = "histogram-mixture (loss=kl)"
    handles = [Line2D([], [], label=label)] * 4
    with styled():
        figure, _ = panels([[Labels("x", "y", "a")]], (2.0, 1.5), handles, handle_length=3.2)
        figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.width


def test_rows_of_panels_are_as_few_and_as_full_as_can_be():
    assert [rows_of(n) for n in (1, 4, 5, 12)] == [[1], [4], [3, 2], [4, 4, 4]]
    assert rows_of(13) == [4, 4, 4, 1]


def test_time_per_sample_carries_its_interval(failing: Path):
    found = nanoseconds_per_sample(Results.load(failing), "suede", "cosine", "studio-sphere")
    assert isinstance(found, str)
    found = nanoseconds_per_sample(
        Results.load(failing), "elephant-hide", "cosine", "studio-sphere"
    )
    assert found.low < found.value < found.high


def test_figures_say_why_they_are_not_there(tmp_path: Path):
    results = Results.load(Made(measures=("fit",)).write(tmp_path))
    for name, figure in parts("figures").items():
        assert "no trial" in figure.load()(results, Canvas(tmp_path)), name


def test_convergence_below_the_noise_or_without_repeats(failing: Path, tmp_path: Path):
    results = Results.load(failing)
    hopeless, single = results.trials("convergence", MATERIALS[0])[:2]
    results.stored(hopeless).arrays["errors"][:] = -1.0
    for name in ("errors", "all_seconds"):
        arrays = results.stored(single).arrays
        arrays[name] = arrays[name][:, :1]
    for trial in results.trials("convergence", MATERIALS[1]):
        results.stored(trial).arrays["errors"][:] = -1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drawn = part("figures", "convergence")(results, Canvas(tmp_path))
    assert drawn[0].png.is_file()


def test_infinite_divergence_is_named_not_drawn(failing: Path, tmp_path: Path):
    results = Results.load(failing)
    frame = results.frame.copy()
    rows = (frame["metric"] == "chi2") & (frame["method"] == "cosine")
    frame.loc[rows, ["value", "ci_low", "ci_high"]] = math.inf
    changed = replace(results, frame=frame)
    with styled():
        drawn = part("figures", "tradeoff")(changed, Canvas(tmp_path))
    assert drawn[0].png.stat().st_size > 10_000
    assert cell_of(part("tables", "pdf")(changed), MATERIALS[0], "cosine", 1).parts[0] == "∞"
    mean = cell_of(part("tables", "pdf")(changed), "geometric mean", "cosine", 1)
    assert "not positive and finite" in mean.missing
