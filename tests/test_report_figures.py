"""Figures: what is drawn, what is left out and why."""

from __future__ import annotations

import itertools
import math
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.ft2font import FT2Font
from matplotlib.lines import Line2D

from harness.analysis.combine import Estimate
from harness.analysis.quantities import nanoseconds_per_sample
from harness.analysis.records.convergence import curve_of
from harness.analysis.results import MethodColumn, Results
from harness.report.figures import fonts, palette
from harness.report.figures.canvas import Canvas
from harness.report.figures.curve_grid import groups
from harness.report.figures.log_panel import LogPanel, powers_of_ten, tick_label, ticks
from harness.report.figures.palette import looks
from harness.report.figures.picture_row import row_of
from harness.report.figures.rendered import exposure, reference, srgb
from harness.report.figures.small_multiples import Labels, panels
from harness.report.figures.style import styled
from harness.report.figures.tradeoff import Point, _front, _means
from harness.report.parts import part, parts
from harness.report.series.shots import shots, telling_squares, truth, worst_square
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


def test_looks_are_told_apart_in_grey():
    """Every two of the first twenty-five by marker, dash or luminance; words are dark enough."""
    methods = [MethodColumn(name, name) for name in palette._KNOWN]
    methods += [MethodColumn(f"new-{i}", "new") for i in range(len(palette._SPARE))]
    chosen = list(palette.looks_of(methods).values())
    assert len({look.colour for look in chosen}) == len(chosen) == 25
    alike = [p for p in itertools.combinations(chosen, 2) if not palette.told_apart(*p)]
    assert alike == []
    for look in chosen:
        # WCAG's contrast on white.
        assert 1.05 / (palette.luminance(look.ink) + 0.05) >= 4.5
    assert palette.luminance("#ffffff") == pytest.approx(1)
    assert not palette.told_apart(palette.Look("#101010", "o"), palette.Look("#181818", "h"))
    assert palette.told_apart(palette.Look("#101010", "o"), palette.Look("#cccccc", "h"))


def test_the_font_of_figures_is_kept_or_else_taken_whole(tmp_path: Path, monkeypatch):
    """Same letters, same widths; a name in another script is in the whole font."""
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    sizes = {}
    for kept, folder in (("kept", tmp_path), ("whole", nowhere)):
        monkeypatch.setattr(fonts.fontManager, "ttflist", list(fonts.fontManager.ttflist))
        monkeypatch.setattr(fonts.mpl, "get_cachedir", lambda folder=folder: str(folder))
        fonts.family.cache_clear()
        names = fonts.family()
        entries = [e for e in fonts.fontManager.ttflist if e.name == names[0]]
        plain = next(e for e in entries[-4:] if e.style == "normal" and e.weight == 400)
        sizes[kept] = Path(plain.fname).stat().st_size
        font = FT2Font(plain.fname)
        sizes[kept, "widths"] = [font.load_char(ord(c)).horiAdvance for c in "spp χ²−⁵é"]
        monkeypatch.undo()
    fonts.family.cache_clear()
    assert sizes["kept"] < 0.5 * sizes["whole"]
    assert sizes["kept", "widths"] == sizes["whole", "widths"]


def test_ticks_are_round_few_and_in_range():
    for low, high in ((1, 16), (0.0034, 0.18), (3e-5, 4e9), (1.1, 1.9), (2.2e-4, 2.6e-4)):
        found = ticks((low, high), 4)
        assert 1 <= len(found) <= 4 and all(low <= v <= high for v in found)
        mantissas = [v / 10 ** math.floor(math.log10(v) + 1e-9) for v in found]
        assert all(math.isclose(m, round(m, 1)) for m in mantissas)
    assert [tick_label(v) for v in (0.01, 1, 1000, 1e5, 3e-4)] == [
        "0.01",
        "1",
        "1000",
        "1e5",
        "3e−4",
    ]
    assert [powers_of_ten(v) for v in (1e-3, 1, 1e5, 3)] == ["10⁻³", "10⁰", "10⁵", "3"]


def test_a_panel_puts_decades_apart_and_guides_have_their_slope():
    panel = LogPanel((1, 2, 3, 4), (1, 1000), (0.1, 10))
    np.testing.assert_allclose(panel.at([1, 10, 1000], [0.1, 1, 10]), [[1, 2], [2, 4], [4, 6]])
    np.testing.assert_allclose(panel.inside([0.1, 1e9], [5e-4, 99]), [[1, 2], [4, 6]])
    drawn = []

    class Pencil:
        def line(self, points: np.ndarray, *_: object, **__: object) -> None:
            drawn.append(points)

    panel.guides(Pencil(), -1.0, 10.0, "k")
    assert len(drawn) >= 4
    for (x0, y0), (x1, y1) in drawn:
        # A decade is one inch across and two along.
        assert (y1 - y0) / 2 == pytest.approx(-(x1 - x0))
        assert 1 <= x0 <= x1 <= 4.001 and 2 - 1e-9 <= y1 <= y0 <= 6 + 1e-9


def test_methods_are_few_to_a_column_and_the_baseline_is_in_each():
    methods = [MethodColumn(name, name) for name in "abcdefghij"]
    found = groups(methods, "d")
    assert [group[0] for group in found] == ["d"] * 3
    assert [name for group in found for name in group[1:]] == list("abcefghij")
    assert {len(group) for group in found} == {4}
    assert groups(methods[:1], "a") == [["a"]]
    assert groups(methods[:2], "") == [["a", "b"]]


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
    assert sheet.png.name == "materials-studio-sphere.png" and sheet.width == 7 * 110
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


def test_pictures_are_shown_before_the_renders_that_were_timed(tmp_path: Path):
    """With their own reference and error; a material that has none keeps its renders."""
    made = Made(materials=MATERIALS[:2], measures=("pictures", "equal-time"), size=16)
    made.fail[("pictures", None, MATERIALS[1])] = ("error", "no light")
    results = Results.load(made.write(tmp_path))
    large, small = (shots(results, m, "studio-sphere") for m in MATERIALS[:2])
    assert {shot.image.shape for shot in large} == {(32, 32, 3)}
    assert {shot.image.shape for shot in small} == {(16, 16, 3)}
    right = truth(results, MATERIALS[0], "studio-sphere", large)
    assert right.shape == (32, 32, 3)
    assert truth(results, MATERIALS[1], "studio-sphere", small) is None
    variance = float(results.arrays(large[0].trial)["variance"])
    assert large[0].spp.value == 7
    assert large[0].relative_mse.value == pytest.approx(variance / 7 / 0.1)
    (drawn,) = part("figures", "images")(results, Canvas(tmp_path))
    assert drawn.png.name == "images-studio-sphere.png" and drawn.png.stat().st_size > 10_000


def test_convergence_without_all_times_has_their_medians(failing: Path, tmp_path: Path):
    """As trials of an older harness: no bars along the time, and no traceback."""
    results = Results.load(failing)
    for trial in results.trials("convergence"):
        arrays = results.stored(trial).arrays
        arrays["seconds"] = np.median(arrays.pop("all_seconds"), axis=1)
    curve = curve_of(results.arrays(results.trials("convergence")[0]))
    assert np.isfinite(curve["seconds"]).all() and np.isnan(curve["seconds_low"]).all()
    drawn = part("figures", "convergence")(results, Canvas(tmp_path))
    assert drawn[0].png.is_file()


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


def test_means_are_over_the_materials_that_all_methods_have():
    """A method that has a number on few of them is left out, and said to be."""
    methods = [MethodColumn(name, name) for name in ("all", "most", "few")]
    has = {"a": "all most few", "b": "all most", "c": "all"}
    error = {"a": 1.0, "b": 4.0, "c": 100.0}
    of = {
        material: [
            Point(m, Estimate(2.0, 1.9, 2.1), Estimate(error[material], 0.5, 200.0))
            for m in methods
            if m.label in has[material].split()
        ]
        for material in has
    }
    means, over, left_out = _means(SimpleNamespace(methods=methods), of)
    assert over == ["a", "b"] and left_out == ["few"]
    assert {p.method.label: p.error.value for p in means} == pytest.approx({"all": 2, "most": 2})
    assert _means(SimpleNamespace(methods=methods[2:]), {"b": of["b"], "c": of["c"]})[0] == []


def test_pictures_leave_out_what_the_suite_does_not_plan(tmp_path: Path):
    folder = Made(measures=("equal-time",), methods=["cosine", "improved-baseline"]).write(tmp_path)
    results = Results.load(folder)
    results.methods.append(MethodColumn("elsewhere", "tabulated"))
    material, scene = results.materials[0], results.scenes("equal-time")[0]
    row = row_of(results, material, scene, 1)
    assert [shot.method.label for shot in row.shots] == ["cosine", "improved-baseline"]
