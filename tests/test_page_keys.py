"""The page by keyboard alone, in Chromium; and a stranger's question, answered for any cell."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_page_browser import (
    CHROMIUM,
    Watched,
    browser,
    canvas_bytes,
    file,
    loaded,
    prepared,
    results,
)

__all__ = ["browser", "file", "loaded", "prepared", "results"]  # fixtures
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed here")

NUMBER = r"[\d.]+(?: (?:[kMG]|µs|ms|s|min|h|d))?"


@pytest.fixture(scope="module")
def tab(browser, file: Path) -> Iterator:
    made = Watched(browser, file)
    made.tab.set_default_timeout(120_000)  # of a loaded machine; passing takes a moment
    yield made.tab
    assert made.wrong == []
    made.tab.close()


def active(tab, what: str):
    return tab.evaluate(f"document.activeElement.{what}")


def test_tab_goes_through_the_controls_in_their_order_and_shows_where_it_is(tab):
    places = []
    for _ in range(12):
        tab.keyboard.press("Tab")
        style = "getComputedStyle(document.activeElement)"
        assert tab.evaluate(f"{style}.outlineStyle") == "solid"
        assert tab.evaluate(f"parseFloat({style}.outlineWidth)") >= 2
        places.append(tab.evaluate(
            "[...document.querySelectorAll('*')].indexOf(document.activeElement)"
        ))  # fmt: skip
    assert places == sorted(set(places))


def test_every_control_has_a_name(tab):
    tab.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    tab.locator("#images").scroll_into_view_if_needed()
    tab.locator(".flips button").first.wait_for()
    nameless = tab.evaluate("""() => [...document.querySelectorAll(
        'button, input, select, canvas[tabindex], a, summary, [tabindex="0"]')].filter(one =>
        !(one.getAttribute('aria-label') || one.textContent.trim() || one.title
          || (one.labels && [...one.labels].some(label => label.textContent.trim())))
      ).map(one => one.outerHTML.slice(0, 99))""")
    assert nameless == []


@pytest.mark.parametrize("key", ["Enter", "Space"])
def test_a_heading_sorts_by_key(tab, key: str):
    head = tab.locator("#table-table2 thead th").nth(2)
    head.scroll_into_view_if_needed()
    head.locator("button").focus()
    before = head.get_attribute("aria-sort")
    tab.keyboard.press(key)
    assert head.get_attribute("aria-sort") != before
    assert active(tab, "closest('th') !== null")  # the focus stays where it was


def test_a_trial_keeps_the_focus_and_gives_it_back(tab):
    number = tab.locator("#table-table2 tbody td button").first
    number.focus()
    tab.keyboard.press("Enter")
    assert tab.locator("dialog[open]").count() == 1
    for key in ["Tab"] * 12 + ["Shift+Tab"] * 14:
        tab.keyboard.press(key)
        assert active(tab, "closest('dialog') !== null")
    tab.keyboard.press("Escape")
    assert tab.locator("dialog[open]").count() == 0
    assert number.evaluate("one => one === document.activeElement")


def test_a_press_beside_a_trial_closes_it_and_does_no_more(tab):
    tab.locator("#table-table2 tbody td button").first.click()
    shown = tab.evaluate("location.hash")
    tab.mouse.click(5, 450)
    assert tab.locator("dialog[open]").count() == 0
    assert shown
    tab.wait_for_function("location.hash === ''")


def test_images_flip_move_and_tell_their_values_by_key(tab):
    tab.locator("#images").scroll_into_view_if_needed()
    first = tab.locator(".flips button").first
    first.wait_for()
    first.focus()
    for _ in range(2):
        tab.keyboard.press("ArrowDown")
    assert tab.locator(".flips [aria-pressed=true]").inner_text().startswith("2")
    assert active(tab, "dataset.method") == tab.locator(
        ".flips [aria-pressed=true]").get_attribute("data-method")  # fmt: skip
    canvas = tab.locator(".stage canvas").first
    canvas.focus()
    whole = canvas_bytes(tab)
    tab.keyboard.press("+")
    assert canvas_bytes(tab) != whole
    zoomed = tab.evaluate("({...view})")
    tab.keyboard.press("ArrowLeft")
    assert tab.evaluate("view.x") < zoomed["x"]
    tab.keyboard.press("Shift+ArrowRight")
    tab.wait_for_function("document.querySelector('.values').innerText.includes('pixel')")
    at = tab.evaluate("view.pointer")
    tab.keyboard.press("Shift+ArrowDown")
    assert tab.evaluate("view.pointer") == [at[0], at[1] + 1]
    tab.keyboard.press("Home")
    assert tab.evaluate("view.zoom") == 1


@pytest.mark.parametrize("material", ["suede", "brocade", "star-tiles"])
def test_a_stranger_is_told_which_by_how_much_whether_it_holds_and_where(tab, material: str):
    """For a material and a number of samples of the reader's choice, at the top of the page."""
    tab.locator("#answer .form select").first.select_option(label=material)
    slider = tab.locator("#answer input[type=range]")
    slider.focus()
    tab.keyboard.press("Home")
    for _ in range(16):
        tab.keyboard.press("ArrowRight")
    samples = tab.locator("#answer .field output").inner_text()
    said = tab.locator(".advice").inner_text()
    labels = tab.evaluate("report.methods.map(method => method.label)")
    used = re.search(rf"Use (.+): {NUMBER} \[{NUMBER}, {NUMBER}\] to the error of (.+) samples of",
                     said)  # fmt: skip
    assert used and used[1].strip() in labels and used[2] == samples
    # A factor with its interval, or that there is none.
    factor = r"(?P<v>[\d.e−]+)× \[(?P<l>[\d.e−]+), (?P<h>[\d.e−]+)\]"
    next_is = rf"The next, (?P<next>.+), takes {factor} as long"
    unknown = r"How much longer the next, (?P<next>.+), takes is not resolved"
    margin = re.search(next_is, said) or re.search(unknown, said)
    assert margin, said
    assert margin["next"] in labels and margin["next"] != used[1].strip()
    if "v" in margin.groupdict():
        low, value, high = (float(margin[end].replace("−", "-")) for end in "lvh")
        assert 0 < low <= value <= high
    training = re.search(r"Would a second training change it\? (No|It may|Not known): ?(.*)", said)
    assert training
    if training[1] != "Not known":
        assert re.search(r"first with \d+ of \d+ trainings", training[2])
    assert re.search(r"In the image the methods differ most at (upper|middle|lower|centre)", said)
    # The sentence leads there.
    tab.locator(".advice a", has_text="bright as the whole").click()
    assert tab.evaluate("view.zoom") > 1
    assert tab.evaluate("report.materials[choice.material]") == material
