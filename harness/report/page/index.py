"""An index over the suites in a folder: what each says, what of it holds, and its page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from harness.analysis.results import Results
from harness.analysis.status import counted, folders
from harness.core.protocol.errors import InputError
from harness.report.page.answer import answer
from harness.report.page.circumstances import facts
from harness.report.page.shell import whole
from harness.report.write import Report
from harness.store.database import FILE, file_of

SCRIPTS = ("state.js", "elements.js", "index.js")


def index(place: Path) -> tuple[str, list[Path]]:
    """The document, and the results folders whose own page is missing or older than their results.

    Raises:
        InputError: no results are at or below ``place``.
    """
    found = folders(place)
    if not found:
        raise InputError(f"{place}: holds no results, nor do the folders in it")
    suites, old = [], []
    for folder in found:
        entry, fresh = _suite(folder, place)
        suites.append(entry)
        if not fresh:
            old.append(folder)
    count = f"{len(found)} suite{'s' * (len(found) != 1)}"
    return whole(f"Results in {place.name}", [count], SCRIPTS, {"suites": suites}), old


def _suite(folder: Path, place: Path) -> tuple[dict[str, Any], bool]:
    page = folder / "report" / "index.html"
    link = page.relative_to(place).as_posix()
    try:
        results = Results.load(folder)
        report = Report.of(results)
    except InputError as error:
        return {"name": folder.name, "title": folder.name, "why": str(error)}, True
    fresh = (
        page.is_file()
        and page.stat().st_mtime >= (file_of(folder) or folder / FILE).stat().st_mtime
    )
    status = counted(folder, results)
    return {
        "name": folder.name,
        "title": results.title,
        "facts": facts(results),
        "status": status.line(),
        "holds": status.all_valid,
        "sentences": answer(results, report.tables)["sentences"],
        "page": link,
    }, fresh
