"""The page: plain data beside scripts; no text that a user may choose is markup."""

from __future__ import annotations

import base64
import json
import zlib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from jinja2 import UndefinedError

from harness.report import write as reports
from harness.report.formats.html import render
from harness.report.page.build import Page, page
from harness.report.page.cells import without_constants
from harness.report.page.names import Names
from harness.report.page.plain import number, packed, script_json
from harness.report.table import Cell, Row, Section, Table
from tests.report_reading import page_data
from tests.report_results import Made

HOSTILE = [
    "</title><script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "<!--<script>",
    "a]]>\x00b\u2028",
]


class Parsed(HTMLParser):
    """Elements with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))


def made_page(folder: Path, **made) -> str:
    loaded = reports.load(Made(**made).write(folder))
    return page(Page(loaded.results, loaded.tables, [], loaded.skipped))


@pytest.mark.parametrize("name", HOSTILE)
def test_names_are_data_and_never_elements(tmp_path: Path, name: str):
    def of(label: str, folder: str) -> str:
        return made_page(
            tmp_path / folder, materials=[label], methods=["cosine", label], scenes=(label,),
            measures=("equal-time", "pdf"), title=label, size=8,
            fail={("pdf", label, None): ("error", label)},
        )  # fmt: skip

    hostile, plain = of(name, "hostile"), of("plain", "plain")
    assert Parsed(hostile).elements == Parsed(plain).elements
    data = page_data(hostile)
    assert data["materials"] == [name] and data["title"] == name
    assert name in [method["label"] for method in data["methods"]]
    assert any(name in note for table in data["tables"] for note in table["notes"])


@given(st.recursive(st.text() | st.none() | st.integers(), st.lists))
@settings(max_examples=60, deadline=None)
def test_json_in_a_script_element_is_whole(data):
    text = script_json(data)
    assert "<" not in text and ">" not in text
    same = json.dumps(data).encode("utf-8", "replace")
    assert json.loads(text) == json.loads(same)


@given(
    arrays_of.arrays(
        st.sampled_from([np.dtype("u1"), np.dtype("f2")]),
        arrays_of.array_shapes(min_dims=1, max_dims=3, max_side=9),
    )
)
@settings(max_examples=60, deadline=None)
def test_arrays_come_back_bit_by_bit(array: np.ndarray):
    """As assets/unpack.js undoes it."""
    found = packed(array)
    steps = np.frombuffer(zlib.decompress(base64.b64decode(found["data"])), np.uint8)
    if found["bits"] == 16:
        high, low = np.split(steps.astype(np.uint16), 2)
        steps = (high << 8) | low
    values = np.cumsum(steps.reshape(found["shape"]), -1, dtype=steps.dtype)
    assert (values == array.view(steps.dtype)).all()


def test_numbers_that_json_lacks():
    assert number(float("nan")) is None and number(None) is None
    assert number(float("-inf")) == "-Infinity"
    assert number(2.0) == 2 and number(1 / 3) == 0.333333


def test_every_number_names_its_trials(tmp_path: Path):
    data = page_data(made_page(tmp_path, materials=["suede", "brocade"], size=8, seeds=(0, 1)))
    trials, measures = data["trials"]["list"], data["measures"]
    table = next(table for table in data["tables"] if table["name"] == "table2")
    for row in table["sections"][0]["rows"]:
        for label, cell in zip(table["columns"], row["cells"], strict=True):
            behind = [trials[i] for i in cell["k"]]
            assert {data["methods"][t["d"]]["label"] for t in behind} == {label}
            assert {measures[t["e"]] for t in behind} == {"equal-time", "equal-spp"}
            if not row.get("summary"):
                assert {data["materials"][t["m"]] for t in behind} == {row["label"]}
                assert sorted(t["seed"] for t in behind) == [0, 0, 1, 1]


def test_what_is_the_same_everywhere_is_a_sentence(tmp_path: Path):
    names = Names(reports.load(Made(materials=["suede"], size=8).write(tmp_path)).results)
    rows = [
        Row(str(i), [Cell(1.0, text="1×"), Cell(float(i)), Cell(0.0, missing="" if i else "no")])
        for i in range(4)
    ]
    zeros = [Row(str(i), [Cell(0.0)] * 3) for i in range(3)]
    table = Table(
        "t", "T", "", "row", ["same", "other", "gap"], [Section("a", rows), Section("b", zeros)]
    )
    sections, columns, said = without_constants(table, names)
    assert [section.title for section in sections] == ["a"]
    assert columns == [1, 2]  # one with a gap is not the same everywhere
    assert said == ["b: 0 everywhere.", "same: 1× everywhere."]


def test_two_trainings_are_compared(tmp_path: Path):
    one = page_data(made_page(tmp_path / "one", materials=["suede"], size=8))
    two = page_data(made_page(tmp_path / "two", materials=["suede"], size=8, seeds=(0, 1)))
    assert "trained once (seed 0)" in one["answer"]["sentences"][2]
    assert "of 2 trainings" in two["answer"]["sentences"][2]


def test_the_answer_does_not_name_a_biased_method(tmp_path: Path):
    methods = ["cosine", "improved-baseline", "two-lobe", "histogram-mixture"]
    fair = page_data(made_page(tmp_path / "a", materials=["suede"], methods=methods, size=8))
    bias = {("histogram-mixture", "suede"): 1e-12}
    wrong = page_data(
        made_page(tmp_path / "b", materials=["suede"], methods=methods, size=8, bias=bias)
    )
    assert fair["answer"]["sentences"][0].startswith("Use histogram-mixture: ")
    assert wrong["answer"]["sentences"][0].startswith("Use two-lobe: ")


def test_a_template_that_misses_a_value_says_so():
    with pytest.raises(UndefinedError, match="title"):
        render("page.html")


def test_templates_are_the_only_place_with_markup():
    """No file of the package adds HTML strings together."""
    for file in (Path(reports.__file__).parent).rglob("*.py"):
        text = file.read_text("utf-8")
        for tag in ("<td", "<table", "<li>", "<div", "<a href"):
            assert tag not in text, (file, tag)
