"""The report as one page: tables, figures, circumstances; no script, nothing from elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from harness.analysis.results import Results
from harness.report.formats.html import html
from harness.report.table import Table
from harness.report.tables.common import machine_words

if TYPE_CHECKING:
    from harness.report.figures.canvas import Drawn


@dataclass(frozen=True)
class Page:
    """What goes on the page; ``skipped`` are the things left out, with their reasons."""

    results: Results
    tables: list[Table]
    figures: list[Drawn]
    skipped: list[str]


def page(content: Page) -> str:
    """The whole document. Figures are linked by relative path."""
    results = content.results
    style = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    tables = [table for table in content.tables if table.name != "status"]
    status = [table for table in content.tables if table.name == "status"]
    wide = [figure for figure in content.figures if not _is_image(figure)]
    renders = [figure for figure in content.figures if _is_image(figure)]
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{escape(results.title)}</title>",
        f"<style>\n{style}</style></head><body>",
        _head(results),
        _contents(tables, wide, renders),
        "<main>",
        '<h2 id="tables">Tables</h2>' if tables else "",
        *(html(table) for table in tables),
        '<h2 id="figures">Figures</h2>' if wide else "",
        *(_figure(figure) for figure in wide),
        '<h2 id="renders">Renders of equal time</h2>' if renders else "",
        *(_figure(figure) for figure in renders),
        '<h2 id="trials">Trials</h2>',
        *(html(table) for table in status),
        _left_out(content.skipped),
        '<h2 id="again">Circumstances</h2>',
        _circumstances(results),
        "</main></body></html>",
    ]
    return "\n".join(part for part in parts if part) + "\n"


def _is_image(figure: Drawn) -> bool:
    return figure.png.name.startswith("images-")


def _head(results: Results) -> str:
    scenes = [scene for scene in dict.fromkeys(results.frame["scene"]) if scene]
    facts = [
        _count(len(results.materials), "material"),
        _count(len(results.methods), "method"),
        _count(len(scenes), "scene") if scenes else "",
        f"profile {results.profile}" if results.profile else "",
    ]
    line = " · ".join(escape(fact) for fact in facts if fact)
    failed = results.frame.loc[results.frame["status"] != "ok", "trial"].nunique()
    if failed:
        count = _count(failed, "trial")
        line += f' · <a class="warning" href="#trials">{count} without a number</a>'
    return f"<header><h1>{escape(results.title)}</h1><p>{line}</p></header>"


def _contents(tables: list[Table], figures: list[Drawn], renders: list[Drawn]) -> str:
    links = [(f"#table-{table.name}", table.title) for table in tables]
    links += [(f"#{figure.png.stem}", figure.title) for figure in figures]
    links += [("#renders", "Renders")] if renders else []
    links += [("#trials", "Trials"), ("#again", "Circumstances")]
    items = "".join(
        f'<li><a href="{escape(to, quote=True)}">{escape(text)}</a></li>' for to, text in links
    )
    return f"<nav><ul>{items}</ul></nav>"


def _figure(figure: Drawn) -> str:
    def link(path: Path) -> str:
        return escape(f"figures/{path.name}", quote=True)

    files = " · ".join(
        f'<a href="{link(path)}">{escape(path.suffix[1:])}</a>' for path in figure.files
    )
    alt = escape(figure.title, quote=True)
    return (
        f'<figure id="{escape(figure.png.stem, quote=True)}"><h3>{escape(figure.title)}</h3>'
        f'<div class="scroll" tabindex="0"><img src="{link(figure.png)}" alt="{alt}" '
        f'width="{figure.width}" height="{figure.height}" loading="lazy"></div>'
        f"<figcaption>{escape(figure.caption)} <span class=files>{files}</span></figcaption>"
        "</figure>"
    )


def _left_out(skipped: list[str]) -> str:
    if not skipped:
        return ""
    items = "".join(f"<li>{escape(message)}</li>" for message in skipped)
    return f"<h3>Left out of this report</h3><ul class=notes>{items}</ul>"


def _circumstances(results: Results) -> str:
    """Environments of the trials, without repetition, and the commands."""
    found: dict[str, None] = {}
    for trial in dict.fromkeys(results.frame["trial"]):
        for line in _environment(results.stored(trial).environment):
            found[line] = None
    items = "".join(f"<li>{escape(line)}</li>" for line in found)
    profile = f" --profile {results.profile}" if results.profile else ""
    device = str(results.plan.get("device") or "cpu")
    profile += f" --device {device}" if device != "cpu" else ""
    name = str(results.plan.get("suite") or results.folder.name)
    commands = f"harness run suites/{name}.yaml{profile}\nharness report results/{name}"
    return (
        f"<ul>{items}</ul>"
        "<p>The first command measures what is not stored yet and makes this report; the second "
        "makes it again from what is stored. The suite as run is "
        '<a href="../suite.yaml">suite.yaml</a>.</p>'
        f'<pre class="scroll">{escape(commands)}</pre>'
    )


def _environment(environment: dict) -> list[str]:
    lines = []
    machine = machine_words(environment.get("machine", ""))
    if machine:
        device = environment.get("device", "")
        lines.append(f"Machine: {machine}" + (f"; device {device}" if device else ""))
    versions = dict(environment.get("versions") or {})
    if environment.get("python"):
        versions = {"python": environment["python"], **versions}
    if versions:
        said = ", ".join(f"{name} {version or '(none)'}" for name, version in versions.items())
        lines.append(f"Versions: {said}")
    return lines


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
