"""The page: one file of plain data, a template, style and scripts; nothing from elsewhere."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from harness.analysis.results import Results
from harness.report.page.advice import advice
from harness.report.page.answer import answer
from harness.report.page.cells import plain_table
from harness.report.page.circumstances import circumstances, facts
from harness.report.page.names import Names
from harness.report.page.pictures import pictures, sizes
from harness.report.page.plots import charts, convergence, densities
from harness.report.page.shell import whole
from harness.report.page.trials import command, trials
from harness.report.table import Table

if TYPE_CHECKING:
    from harness.report.figures.canvas import Drawn

SCRIPTS = (
    "state.js", "elements.js", "unpack.js", "trial.js", "answer.js", "tables.js", "records.js",
    "images.js", "pane.js", "viewer.js", "plot.js", "convergence.js", "pareto.js", "breakeven.js",
    "densities.js", "main.js",
)  # fmt: skip
"""Scripts of the page in the order in which they run."""
_FIGURES = 2_500_000
"""Characters of print figures on a page; those beyond are linked."""


@dataclass(frozen=True)
class Page:
    """What goes on the page; ``skipped`` are the things left out, with their reasons."""

    results: Results
    tables: list[Table]
    figures: list[Drawn]
    skipped: list[str]


PARTS: dict[str, Callable[[Results], Any]] = {
    "images": pictures,
    "charts": charts,
    "advice": advice,
    "trials": trials,
    "convergence": convergence,
    "densities": densities,
}
"""What takes long, the longest first; each is made of the results alone."""


def page(content: Page, prepared: Mapping[str, Any] | None = None) -> str:
    """The whole document. The same results give the same text.

    ``prepared`` are the :data:`PARTS`, where they are made already.
    """
    if prepared is None:
        prepared = {name: make(content.results) for name, make in PARTS.items()}
    images = dict(prepared["images"])
    pixels = images.pop("pixels")
    data = document(content) | prepared | {"images": images | {"sizes": list(sizes(images))}}
    plots = bool(data["convergence"] or data["charts"] or data["advice"]["cells"])
    return whole(content.results.title, data["facts"], SCRIPTS, data, pixels, plots)


def document(content: Page) -> dict[str, Any]:
    """What the page shows beside its :data:`PARTS`, as plain data."""
    results = content.results
    names = Names(results)
    return {
        "title": results.title,
        "baseline": results.baseline,
        "facts": facts(results),
        "methods": names.looks(),
        "materials": names.materials,
        "scenes": names.scenes,
        "measures": names.measures,
        "answer": answer(results, content.tables),
        "tables": [plain_table(table, names) for table in content.tables],
        "command": command(results),
        "suite": str(results.plan.get("suite") or results.folder.name),
        "figures": _figures(content.figures),
        "skipped": content.skipped,
        "circumstances": circumstances(results),
    }


def _figures(drawn: list[Drawn]) -> list[dict[str, Any]]:
    """Figures for print: their files' names, and the picture itself while there is room."""
    made, size = [], 0
    for figure in drawn:
        entry = {
            "title": figure.title,
            "caption": figure.caption,
            "files": [path.name for path in figure.files],
            "width": figure.width,
            "height": figure.height,
        }
        data = base64.b64encode(figure.png.read_bytes()).decode("ascii")
        if size + len(data) <= _FIGURES:
            size += len(data)
            entry["png"] = data
        made.append(entry)
    return made
