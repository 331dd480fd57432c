"""What tests of the report ask of a folder, a table and a page."""

from __future__ import annotations

import io
import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from rich.console import Console

from harness.analysis.results import Results
from harness.report import write as reports
from harness.report.parts import part
from harness.report.table import Cell, Table

WEIRD = r"a_b & 50% #1 {x}~^\y|<i>$*`[z]"


def printed(folder: Path, width: int = 120) -> str:
    out = io.StringIO()
    reports.load(folder).print(Console(file=out, width=width, force_terminal=False))
    return out.getvalue()


def table_of(folder: Path, name: str) -> Table:
    table = part("tables", name)(Results.load(folder))
    assert isinstance(table, Table), table
    return table


def cell_of(table: Table, row: str, column: str, section: int = 0) -> Cell:
    rows = {r.label: r for r in table.sections[section].rows}
    return rows[row].cells[table.columns.index(column)]


def page_data(text: str) -> dict[str, Any]:
    """The plain data that a page shows."""

    class Reader(HTMLParser):
        found, inside = "", False

        def handle_starttag(self, tag, attrs):
            self.inside = tag == "script" and dict(attrs).get("id") == "data"

        def handle_data(self, data):
            self.found += data if self.inside else ""

    reader = Reader()
    reader.feed(text)
    return json.loads(reader.found)


class Balanced(HTMLParser):
    """Collects ids and links, and checks that every element is closed in order."""

    void = {"meta", "img", "wbr", "br", "link"}

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: set[str] = set()
        self.links: list[str] = []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids |= {given["id"]} if given.get("id") else set()
        self.links += [given[key] for key in ("href", "src") if given.get(key)]
        if tag not in self.void:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
