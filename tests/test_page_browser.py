"""The page in Chromium: it sorts, filters, flips, zooms and opens trials, and asks nobody."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.report import write as reports
from harness.report.page.build import PARTS, Page, page
from harness.report.page.comparison import comparison
from harness.report.page.index import index
from tests.report_results import Made

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed here")

HOSTILE = '<img src=x onerror="window.hacked=1">'
SIZE = 16
RECORDS = 10_000


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Made(
        methods=["cosine", "improved-baseline", "two-lobe", "histogram-mixture", HOSTILE],
        materials=["suede", "brocade", "star-tiles"], seeds=(0, 1), size=SIZE,
    ).write(tmp_path_factory.mktemp("page") / "first")  # fmt: skip


@pytest.fixture(scope="module")
def loaded(results: Path) -> reports.Report:
    return reports.load(results)


@pytest.fixture(scope="module")
def prepared(loaded: reports.Report) -> dict[str, Any]:
    """The page's data, by part."""
    return {name: make(loaded.results) for name, make in PARTS.items()}


def written(path: Path, loaded: reports.Report, prepared: dict[str, Any]) -> Path:
    content = Page(loaded.results, loaded.tables, [], loaded.skipped)
    path.write_text(page(content, prepared), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def file(results: Path, loaded: reports.Report, prepared: dict[str, Any]) -> Path:
    return written(results / "page.html", loaded, prepared)


@pytest.fixture(scope="module")
def large(results: Path, loaded: reports.Report, prepared: dict[str, Any]) -> Path:
    """The page, its trials repeated until they have ten thousand records."""
    trials = prepared["trials"]["list"]
    count = sum(len(trial["records"]) for trial in trials)
    many = prepared["trials"] | {"list": trials * -(-RECORDS // count)}
    return written(results / "large.html", loaded, prepared | {"trials": many})


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


class Watched:
    """A browser's page, and what went wrong in it."""

    def __init__(self, browser, path: Path, width: int = 1200, after: str = ""):
        self.tab = browser.new_page(
            viewport={"width": width, "height": 900}, reduced_motion="reduce"
        )
        self.wrong: list[str] = []
        self.tab.on("console", lambda m: self._note(m.type, m.text))
        self.tab.on("pageerror", lambda e: self._note("error", str(e)))
        self.tab.on("request", lambda r: self._request(r.url))
        self.tab.goto(path.as_uri() + after)
        self.tab.wait_for_selector("html[data-ready]")

    def _note(self, kind: str, text: str) -> None:
        if kind in ("error", "warning"):
            self.wrong.append(text)

    def _request(self, url: str) -> None:
        if not url.startswith(("file:", "blob:", "data:")):
            self.wrong.append(url)


@pytest.fixture
def watched(browser, file: Path) -> Iterator[Watched]:
    made = Watched(browser, file)
    yield made
    assert made.wrong == []
    assert made.tab.evaluate("window.hacked") is None
    made.tab.close()


def in_sight(tab, selector: str) -> None:
    """Scrolled to; what is out of sight is not drawn, and its text is empty."""
    tab.locator(selector).first.scroll_into_view_if_needed()
    tab.wait_for_function("s => document.querySelector(s).innerText !== ''", arg=selector)


def column(tab, at: int) -> list[str]:
    """Texts of a column of the first section of the first table."""
    rows = tab.locator("#table-table2 tbody").first.locator("tr")
    return [row.locator("th, td").nth(at).inner_text().split("\n")[0] for row in rows.all()]


def numbers(texts: list[str]) -> list[float]:
    return [float(text.split("×")[0]) for text in texts if "†" not in text]


def canvas_bytes(tab) -> str:
    return tab.evaluate("document.querySelector('.stage canvas').toDataURL()")


def test_a_heading_sorts_and_means_stay_below(watched: Watched):
    tab = watched.tab
    in_sight(tab, "#table-table2 thead")
    heads = tab.locator("#table-table2 thead").first.locator("th")
    names = heads.all_inner_texts()
    at = next(i for i in range(1, len(names)) if len(numbers(column(tab, i)[:-1])) > 1)
    heads.nth(at).locator("button").click()
    values = numbers(column(tab, at)[:-1])
    assert len(values) > 1 and values == sorted(values, reverse=True)
    assert column(tab, 0)[-1] == "geometric mean"
    heads.nth(at).locator("button").click()
    values = numbers(column(tab, at)[:-1])
    assert values == sorted(values)


def test_rows_are_filtered_and_methods_hidden(watched: Watched):
    tab = watched.tab
    tab.get_by_label("Filter rows of Speed-up at equal time").fill("bro")
    assert column(tab, 0) == ["brocade"]
    tab.get_by_text("Show and hide methods").click()
    tab.locator("#filters .chip", has_text="two-lobe").click()
    assert "two-lobe" not in tab.locator(".dotplot").first.inner_text()
    in_sight(tab, "#table-table2 thead")
    tab.wait_for_function(
        "!document.querySelector('#table-table2 thead').innerText.includes('two-lobe')"
    )


def test_a_number_opens_its_trial_and_a_link_does(watched: Watched, browser, file: Path):
    tab = watched.tab
    tab.locator("#table-table2 tbody td button").first.click()
    text = tab.locator("dialog[open]").inner_text()
    assert "--only material=suede,method=cosine,measure=equal-time" in text
    assert "speedup-equal-time" in text and "Example CPU 3000" in text
    link = tab.evaluate("location.hash")
    tab.keyboard.press("Escape")
    assert tab.locator("dialog[open]").count() == 0
    linked = Watched(browser, file, after=link)
    assert "equal-time" in linked.tab.locator("dialog[open]").inner_text()
    linked.tab.close()


def test_a_hostile_name_is_text(watched: Watched):
    tab = watched.tab
    in_sight(tab, "#table-table2 thead")
    assert HOSTILE in tab.locator("#table-table2 thead").first.inner_text()
    assert tab.locator("img").count() == 0


def test_number_keys_and_hovering_flip(watched: Watched):
    tab = watched.tab
    tab.locator("#images").scroll_into_view_if_needed()
    tab.locator(".flips button").first.wait_for()
    tab.wait_for_timeout(200)
    reference = canvas_bytes(tab)
    tab.locator(".flips button").first.focus()
    tab.keyboard.press("3")
    pressed = tab.locator(".flips [aria-pressed=true]")
    assert "two-lobe" in pressed.inner_text()
    tab.wait_for_function("old => document.querySelector('.stage canvas').toDataURL() !== old",
                          arg=reference)  # fmt: skip
    two_lobe = canvas_bytes(tab)
    tab.locator(".flips button", has_text="cosine").hover()
    tab.wait_for_function("old => document.querySelector('.stage canvas').toDataURL() !== old",
                          arg=two_lobe)  # fmt: skip
    for show in ("false colour", "relMSE", "FLIP"):
        before = canvas_bytes(tab)
        tab.get_by_role("button", name=show, exact=True).click()
        tab.wait_for_function("old => document.querySelector('.stage canvas').toDataURL() !== old",
                              arg=before)  # fmt: skip


def test_panes_zoom_together(watched: Watched):
    tab = watched.tab
    tab.locator("#images").scroll_into_view_if_needed()
    tab.get_by_role("button", name="side by side").click()
    panes = tab.locator(".panes canvas")
    panes.nth(5).wait_for()
    tab.wait_for_timeout(300)
    shots = "[...document.querySelectorAll('.panes canvas')].map(c => c.toDataURL())"
    before = tab.evaluate(shots)
    panes.nth(1).hover()
    tab.mouse.wheel(0, -300)
    tab.mouse.move(0, 0)
    after = tab.evaluate(shots)
    assert len(before) == 6  # the reference and five methods
    assert all(a != b for a, b in zip(before, after, strict=True))
    assert tab.evaluate("view.zoom") > 1


def test_values_under_the_pointer_are_the_stored_ones(watched: Watched, loaded: reports.Report):
    tab = watched.tab
    trial = loaded.results.trials("equal-time", "suede", "two-lobe", "studio-sphere")[0]
    image = loaded.results.stored(trial).images["equal_time"]
    tab.locator("#images").scroll_into_view_if_needed()
    canvas = tab.locator(".stage canvas")
    canvas.wait_for()
    box = canvas.bounding_box()
    x, y = 9, 4
    canvas.hover(
        position={"x": box["width"] * (x + 0.5) / SIZE, "y": box["height"] * (y + 0.5) / SIZE}
    )
    row = tab.locator(".values tr", has_text="two-lobe")
    row.wait_for()
    assert f"pixel {x}, {y}" in tab.locator(".values").inner_text()
    shown = [float(text) for text in row.locator("td").all_inner_texts()[:3]]
    assert shown == pytest.approx(np.float64(image[y, x]).tolist(), rel=6e-3)


def test_ten_thousand_records_are_few_elements(browser, large: Path):
    made = Watched(browser, large)
    tab = made.tab
    tab.get_by_text("Every number of every trial").click()
    frame = tab.locator(".records")
    frame.wait_for()
    tab.wait_for_function("document.querySelectorAll('.records button.record').length > 5")
    assert tab.evaluate("allRecords().length") >= RECORDS
    frame.evaluate("e => { e.scrollTop = e.scrollHeight / 2; }")
    tab.wait_for_timeout(100)
    assert tab.locator(".records button.record").count() < 60
    tab.get_by_label("Filter records").fill("brocade kl pdf two-lobe")
    tab.wait_for_function("document.querySelectorAll('.records button.record').length > 0")
    for text in tab.locator(".records button.record").all_inner_texts():
        assert "two-lobe" in text and "brocade" in text and "kl" in text
    tab.locator(".records button.record").first.click()
    assert "kl" in tab.locator("dialog[open]").inner_text()
    assert made.wrong == []
    tab.close()


def test_a_change_draws_only_what_it_concerns(watched: Watched):
    tab = watched.tab
    in_sight(tab, "#table-table2 thead")
    mark = "document.querySelector('#table-table2 tbody tr').dataset.kept = 'yes'"
    kept = "document.querySelector('#table-table2 tbody tr').dataset.kept === 'yes'"
    tab.evaluate(mark)
    tab.evaluate("choose({stop: 3})")  # the slider is about no table
    assert tab.evaluate(kept)
    tab.evaluate("toggleHidden('methods', 1)")
    assert not tab.evaluate(kept)
    tab.evaluate("window.scrollTo(0, 0)")
    tab.evaluate(mark)
    tab.wait_for_timeout(200)
    tab.evaluate("toggleHidden('methods', 1)")
    waits = tab.evaluate(kept)
    in_sight(tab, "#table-table2 thead")
    tab.wait_for_function(f"!({kept})")
    assert waits


def test_plots_are_drawn_and_the_slider_changes_the_advice(watched: Watched):
    tab = watched.tab
    advice = tab.locator(".advice")
    tab.evaluate("choose({stop: 0})")
    few = advice.inner_text()
    tab.evaluate("choose({stop: 29})")
    assert advice.inner_text() != few and "512 G" in advice.inner_text()
    assert "trainings" in advice.inner_text()
    for figure in tab.locator(".plotting").all():
        figure.scroll_into_view_if_needed()
        figure.locator("svg.main-svg, .density canvas").first.wait_for()


@pytest.mark.parametrize("width", [400, 800])
def test_nothing_runs_out_of_a_narrow_window(browser, file: Path, width: int):
    made = Watched(browser, file, width)
    made.tab.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    assert made.tab.evaluate("document.documentElement.scrollWidth") <= width
    made.tab.close()


def test_the_other_pages_open(browser, results: Path, tmp_path: Path):
    again = Made(materials=["suede"], size=SIZE, seeds=(2,)).write(results.parent / "second")
    pages: list[str] = []
    text = index(results.parent, pages.append)
    assert {Path(page).parent.parent.name for page in pages} == {"first", "second"}
    index(results.parent, pages.append)
    assert len(pages) == 2  # the pages are newer than the results now
    files = {"index.html": text, "comparison.html": comparison([results, again])}
    for name, document in files.items():
        path = tmp_path / name
        path.write_text(document, encoding="utf-8")
        made = Watched(browser, path)
        assert "Speed-up of learned samplers" in made.tab.inner_text("body") or name[0] == "c"
        assert made.wrong == []
        made.tab.close()
