"""Methods, materials, scenes and measures by their place in a list, as the page's data name them.

A cell of a table belongs to the trials of the material, method and scene that its row, column and
section name.
"""

from __future__ import annotations

import re
from functools import cached_property
from typing import Any

from harness.analysis.results import Results
from harness.report.figures.palette import Look, looks
from harness.report.table import Row, Section, Table

_DASHES = {"-": "solid", 5: "dash", 1: "dot", 6: "dashdot", 10: "longdash"}
_SYMBOLS = {
    "o": "circle", "v": "triangle-down", "s": "square", "^": "triangle-up", "<": "triangle-left",
    ">": "triangle-right", "D": "diamond", "P": "cross", "X": "x", "p": "pentagon", "*": "star",
    "h": "hexagon", "d": "diamond-tall", "8": "octagon", "H": "hexagon2",
}  # fmt: skip


class Names:
    """What the page's lists hold, and which trials a cell is made of."""

    def __init__(self, results: Results):
        self.results = results
        frame = results.frame
        self.methods = [method.label for method in results.methods]
        self.materials = results.materials
        self.scenes = [scene for scene in dict.fromkeys(frame["scene"]) if scene]
        self.measures = list(dict.fromkeys(frame["measure"]))

    @cached_property
    def trials(self) -> dict[str, int]:
        """Place of every planned trial, by key."""
        return {key: i for i, key in enumerate(dict.fromkeys(self.results.frame["trial"]))}

    def looks(self) -> list[dict[str, Any]]:
        """Label, colour, symbol and dash of each method."""
        found = looks(self.results)
        return [
            {
                "label": method.label,
                "ceiling": method.ceiling,
                "colour": found[method.label].colour,
                "symbol": _SYMBOLS.get(found[method.label].marker, "circle"),
                "dash": _dash(found[method.label]),
            }
            for method in self.results.methods
        ]

    def behind(self, table: Table, section: Section, row: Row, column: str) -> list[int]:
        """Places of the trials that a cell's number comes from; of those that may be."""
        material = row.material or self._named(self.materials, row.label, column, section.title)
        method = self._named(self.methods, row.label, column) or (
            self._named(self.methods, section.title) if not material else ""
        )
        if not material and not method:
            return []
        scene = self._named(self.scenes, section.title, column)
        if not scene and len(self.scenes) > 1:
            scene = None
        found: dict[int, None] = {}
        for measure in table.measures:
            for each in self.results.rows(measure, material or None, method or None):
                if not scene or each["scene"] in ("", scene):
                    found[self.trials[each["trial"]]] = None
        return list(found)

    @staticmethod
    def _named(names: list[str], *texts: str) -> str:
        """The first of ``names`` that is one of the texts, or a word of it."""
        for text in texts:
            if text in names:
                return text
        for text in texts:
            for name in sorted(names, key=len, reverse=True):
                if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", text):
                    return name
        return ""


def _dash(look: Look) -> str:
    return _DASHES["-" if look.dash == "-" else look.dash[1][0]]
