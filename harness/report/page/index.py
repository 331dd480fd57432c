"""An index over the suites in a folder: what each says, what of it holds, and its page."""

from __future__ import annotations

from collections.abc import Callable
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


def index(place: Path, notify: Callable[[str], None] = lambda message: None) -> str:
    """The document. A suite's own page that is missing or older than its results is made first, and
    ``notify`` is told its path.

    Raises:
        InputError: no results are at or below ``place``.
    """
    found = folders(place)
    if not found:
        raise InputError(f"{place}: holds no results, nor do the folders in it")
    suites = [_suite(folder, place, notify) for folder in found]
    count = f"{len(found)} suite{'s' * (len(found) != 1)}"
    return whole(f"Results in {place.name}", [count], SCRIPTS, {"suites": suites})


def _suite(folder: Path, place: Path, notify: Callable[[str], None]) -> dict[str, Any]:
    page = folder / "report" / "index.html"
    link = page.relative_to(place).as_posix()
    try:
        results = Results.load(folder)
        report = Report.of(results)
    except InputError as error:
        return {"name": folder.name, "title": folder.name, "why": str(error)}
    fresh = (
        page.is_file()
        and page.stat().st_mtime >= (file_of(folder) or folder / FILE).stat().st_mtime
    )
    if not fresh:
        notify(str(report.write()[0]))
    status = counted(folder, results)
    return {
        "name": folder.name,
        "title": results.title,
        "facts": facts(results),
        "status": status.line(),
        "holds": status.all_valid,
        "sentences": answer(results, report.tables)["sentences"],
        "page": link,
    }
