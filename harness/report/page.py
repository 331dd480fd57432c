"""The report as one page: tables, figures, circumstances; no script, nothing from elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from harness.analysis.results import Results
from harness.report.formats.html import render
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
    """The whole document (``templates/page.html``). Figures are linked by relative path."""
    results = content.results
    failed = results.frame.loc[results.frame["status"] != "ok", "trial"].nunique()
    return render(
        "page.html",
        title=results.title,
        facts=_facts(results),
        failed=_count(failed, "trial") if failed else "",
        tables=[table for table in content.tables if table.name != "status"],
        status=[table for table in content.tables if table.name == "status"],
        figures=[figure for figure in content.figures if not _is_image(figure)],
        renders=[figure for figure in content.figures if _is_image(figure)],
        skipped=content.skipped,
        circumstances=_circumstances(results),
        commands=_commands(results),
    )


def _is_image(figure: Drawn) -> bool:
    return figure.png.name.startswith("images-")


def _facts(results: Results) -> list[str]:
    """How many materials, methods and scenes, and the profile."""
    scenes = [scene for scene in dict.fromkeys(results.frame["scene"]) if scene]
    facts = [
        _count(len(results.materials), "material"),
        _count(len(results.methods), "method"),
        _count(len(scenes), "scene") if scenes else "",
        f"profile {results.profile}" if results.profile else "",
    ]
    return [fact for fact in facts if fact]


def _circumstances(results: Results) -> list[str]:
    """Environments of the trials, without repetition."""
    found: dict[str, None] = {}
    for trial in dict.fromkeys(results.frame["trial"]):
        for line in _environment(results.stored(trial).environment):
            found[line] = None
    return list(found)


def _commands(results: Results) -> str:
    """The two commands that make the report, from measuring on and from what is stored."""
    profile = f" --profile {results.profile}" if results.profile else ""
    device = str(results.plan.get("device") or "cpu")
    profile += f" --device {device}" if device != "cpu" else ""
    name = str(results.plan.get("suite") or results.folder.name)
    return f"harness run suites/{name}.yaml{profile}\nharness report results/{name}"


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
    if environment.get("kernels"):
        lines.append(f"Networks on the CPU: {environment['kernels']}")
    return lines


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
