"""Figures of renders: what is enlarged, which methods a close-up has, and that a page has room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas
from harness.report.figures.close_up import LEAST, MOST
from harness.report.figures.picture_row import row_of
from harness.report.figures.style import PAGE, TALL
from harness.report.parts import part
from harness.report.series.shots import square_error
from tests.report_results import MATERIALS, METHODS, Made

SCENE = "studio-sphere"
FEW = ["cosine", "improved-baseline", "two-lobe"]


def drawn(made: Made, folder: Path) -> dict[str, tuple[float, float]]:
    """Inches of the figures, by name; each as PNG and PDF."""
    figures = part("figures", "images")(
        Results.load(made.write(folder / "results")), Canvas(folder)
    )
    for figure in figures:
        assert sorted(path.suffix for path in figure.files) == [".pdf", ".png"]
    return {one.png.stem: (one.width / 110, one.height / 110) for one in figures}


def test_figures_of_many_materials_fit_a_page(tmp_path: Path):
    made = Made(materials=MATERIALS[:6], methods=list(METHODS), measures=("equal-time",), size=8)
    sizes = drawn(made, tmp_path)
    assert len(sizes) > 1
    assert all(w == pytest.approx(PAGE, abs=0.01) and h <= TALL for w, h in sizes.values())


@pytest.mark.parametrize(("materials", "names"), [
    (1, {f"close-up-{MATERIALS[0]}-{SCENE}"}),
    (2, {f"images-{SCENE}"}),
])  # fmt: skip
def test_few_methods_have_one_figure(tmp_path: Path, materials: int, names: set[str]):
    """A single large picture stands alone; several share a figure, with two squares each."""
    made = Made(materials=MATERIALS[:materials], methods=FEW, measures=("equal-time", "pictures"),
                size=LEAST // 2)  # fmt: skip
    assert set(drawn(made, tmp_path)) == names


def test_a_small_picture_has_no_close_up(tmp_path: Path):
    made = Made(materials=MATERIALS[:1], methods=FEW, measures=("equal-time",), size=LEAST // 2)
    assert set(drawn(made, tmp_path)) == {f"images-{SCENE}"}


def test_a_close_up_has_the_baseline_cosine_and_the_best(tmp_path: Path):
    made = Made(materials=MATERIALS[:1], methods=list(METHODS), measures=("equal-time", "pictures"),
                size=LEAST // 2)  # fmt: skip
    results = Results.load(made.write(tmp_path / "results"))
    from harness.report.figures.close_up import _chosen

    everyone = row_of(results, MATERIALS[0], SCENE, 2)
    labels = _chosen(results, everyone)
    assert len(labels) == MOST and {"cosine", "improved-baseline"} <= set(labels)
    known = {s.method.label: s.relative_mse.value for s in everyone.shots if s.image is not None
             and not isinstance(s.relative_mse, str)}  # fmt: skip
    best = sorted(set(known) - {"cosine", "improved-baseline"}, key=known.get)[: MOST - 2]
    assert set(best) <= set(labels)


def test_squares_are_where_methods_differ(tmp_path: Path):
    """The first has the larger spread of errors, and they do not overlap."""
    made = Made(materials=MATERIALS[:1], methods=FEW, measures=("equal-time", "pictures"),
                size=LEAST // 2)  # fmt: skip
    row = row_of(Results.load(made.write(tmp_path / "results")), MATERIALS[0], SCENE, 2)
    first, second = row.squares
    assert max(abs(first.row - second.row), abs(first.column - second.column)) >= first.side
    image = row.shots[0].image.copy()
    rows = slice(first.row, first.row + first.side)
    columns = slice(first.column, first.column + first.side)
    image[rows, columns] = row.reference[rows, columns]
    assert square_error(image, row.reference, first) == 0
    doubled = 2 * np.asarray(row.reference)
    assert square_error(doubled, row.reference, first) == pytest.approx(1)
