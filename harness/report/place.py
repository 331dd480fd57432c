"""The folder of a report: ours by its list of files, and what is said when it cannot be written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from harness.core.outputs import file_to_write, folder_to_fill
from harness.core.protocol.errors import InputError
from harness.report.parts import parts

LIST = "files.txt"
"""Names the files of the report; a folder that has it is a report's."""


_MARK = b'<meta name="generator" content="harness">'
"""In the head of every page."""


def write_page(page: Path, text: str, option: str) -> None:
    """Write a page, unless another's file is there.

    Raises:
        InputError: it is, or the place cannot be written to.
    """
    file_to_write(page, option, _is_page, "a page of the harness")
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{option} {page}: cannot be written: {error.strerror}") from error


def _is_page(path: Path) -> bool:
    with path.open("rb") as file:
        return _MARK in file.read(500)


@contextmanager
def writing_to(report: Path) -> Iterator[None]:
    """Files of a report are written inside; the folder is made.

    Raises:
        InputError: the folder is another's, or it cannot be written. What is stored stays as it is.
    """
    folder_to_fill(report, "report", _is_report, "a report")
    try:
        (report / LIST).touch()
        yield
    except OSError as error:
        raise InputError(
            f"{error.filename or report}: cannot be written: {error.strerror or error}; what is"
            " stored is untouched, and harness report makes the report again"
        ) from error


def _is_report(folder: Path) -> bool:
    """By its list; or by the tables in Markdown that are kept with the code, without the rest."""
    names = {path.name for path in folder.iterdir()}
    return LIST in names or names <= {f"{table}.md" for table in parts("tables")}


def forget_old(report: Path, written: list[Path]) -> None:
    """Remove what an earlier report listed and this one did not make: it would be stale."""
    listed = report / LIST
    now = [path.relative_to(report).as_posix() for path in written]
    before = listed.read_text("utf-8", "replace").splitlines()
    for name in set(before) - set(now):
        # Only what lies inside, whatever the list says.
        path = Path(report.resolve(), *(part for part in Path(name).parts if part != ".."))
        if path.is_relative_to(report.resolve()) and path.is_file() and not path.is_symlink():
            path.unlink()
    listed.write_text("\n".join(now) + "\n", encoding="utf-8")
