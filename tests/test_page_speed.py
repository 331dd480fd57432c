"""How long the page of ten thousand records takes to answer: a user notices a tenth of a second."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.test_page_browser import (
    CHROMIUM,
    Watched,
    browser,
    large,
    loaded,
    prepared,
    results,
)

__all__ = ["browser", "large", "loaded", "prepared", "results"]  # fixtures
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed here"),
]

_TIMED = """async ([act, undo]) => {
  const frame = () => new Promise(done => requestAnimationFrame(() => setTimeout(done)));
  const run = text => (0, eval)(text);
  const found = [];
  for (let i = 0; i < 9; i++) {
    await frame();
    const start = performance.now();
    run(act);
    document.body.getBoundingClientRect();  // layout
    await frame();
    found.push(performance.now() - start);
    run(undo);
  }
  return found;
}"""
"""Milliseconds from an action to the frame that shows it, of nine."""

_FILTER = """(text => {{ const box = document.querySelector('input[aria-label="{label}"]');
  box.value = text; box.dispatchEvent(new Event('input', {{bubbles: true}})); }})"""
_RECORDS = _FILTER.format(label="Filter records")
_SORT = "document.querySelector('#table-table2 thead th:nth-child(3) button').click()"
_CHIP = "document.querySelectorAll('#filters .chip')[1].click()"
_TRIAL = "document.querySelector('.records button.record').click()"
ACTIONS = {
    "filter the records": (f"{_RECORDS}('brocade kl')", f"{_RECORDS}('')"),
    "scroll the records": (
        "document.querySelector('.records').scrollTop = 1e5",
        "document.querySelector('.records').scrollTop = 0",
    ),
    "open a trial": (_TRIAL, "document.querySelector('dialog[open]').close()"),
    "sort a table": (_SORT, _SORT),
    "hide a method": (_CHIP, _CHIP),
    "move the slider": ("choose({stop: 3})", "choose({stop: 20})"),
}


@pytest.mark.parametrize("name", ACTIONS)
def test_ten_thousand_records_answer_within_a_tenth_of_a_second(
    browser, large: Path, name: str, record_property
):
    made = Watched(browser, large)
    made.tab.get_by_text("Every number of every trial").click()
    made.tab.locator(".records button.record").first.wait_for()
    spent = sorted(made.tab.evaluate(_TIMED, list(ACTIONS[name])))
    made.tab.close()
    record_property("milliseconds", spent)
    print(f"{name}: {spent[0]:.0f} ms at best, {spent[len(spent) // 2]:.0f} ms in the middle")
    # The best of nine: what other processes take is not the page's.
    assert spent[0] < 100
