"""The page by templates: every text that a user may choose is escaped where it stands."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from harness.report import write as reports
from harness.report.figures.canvas import Drawn
from harness.report.formats.html import html, render
from harness.report.page import Page, page
from harness.report.table import Cell, Row, Section, Table
from tests.report_results import Made

HOSTILE = [
    "</title><script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onmouseover='alert(1)",
    "{{ 7 * 7 }}{% raw %}",
    "<!--",
    "&lt;b&gt;",
    "a]]>\x00b",
]


class Parsed(HTMLParser):
    """Elements with their attributes, and all text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


def table(name: str) -> Table:
    """A table all of whose texts are ``name``."""
    cells = [Cell(1.0, text=name, warning=name), Cell(missing=name), Cell(2.0, shade=name)]
    rows = [Row(name, cells, about=name)]
    return Table("t", name, name, name, [name] * 3, [Section(name, rows)], legend=[name])


@pytest.mark.parametrize("name", HOSTILE)
def test_a_table_holds_no_element_of_its_texts(name: str):
    hostile, plain = Parsed(html(table(name))), Parsed(html(table("plain")))
    assert [tag for tag, _ in hostile.elements if tag != "wbr"] == [
        tag for tag, _ in plain.elements if tag != "wbr"
    ]
    for (_, found), (_, expected) in zip(
        ((t, a) for t, a in hostile.elements if t != "wbr"),
        ((t, a) for t, a in plain.elements if t != "wbr"),
        strict=True,
    ):
        assert set(found) == set(expected)  # no attribute was opened either
    shown = hostile.text.replace("\ufffd", "\x00")
    # Title, caption, corner, headings, section, row, cell, legend and two footnotes.
    assert shown.count(name) == plain.text.count("plain")


@pytest.mark.parametrize("name", HOSTILE[:4])
def test_a_page_holds_no_element_of_its_names(tmp_path: Path, name: str):
    made = Made(
        materials=[name], methods=["cosine", name], scenes=(name,), measures=("equal-time",),
        title=name, fail={(None, name, None): ("error", name)},
    )  # fmt: skip
    loaded = reports.load(made.write(tmp_path))
    drawn = Drawn(tmp_path / f"{name.replace('/', '')}.png", [], name, name, 1, 1)
    text = page(Page(loaded.results, [*loaded.tables, table(name)], [drawn], [name]))
    parsed = Parsed(text)
    tags = {tag for tag, _ in parsed.elements}
    assert "script" not in tags
    assert not any(key.startswith("on") for _, attrs in parsed.elements for key in attrs)
    for tag, attrs in parsed.elements:
        if tag == "img":
            assert (attrs["src"] or "").startswith("figures/")
    assert name in parsed.text


def test_a_template_that_misses_a_value_says_so():
    with pytest.raises(UndefinedError, match="title"):
        render("page.html")


def test_templates_are_the_only_place_with_markup():
    """No file of the package adds HTML strings together."""
    for file in (Path(reports.__file__).parent).rglob("*.py"):
        text = file.read_text("utf-8")
        for tag in ("<td", "<table", "<li>", "<div", "<a href"):
            assert tag not in text, (file, tag)
