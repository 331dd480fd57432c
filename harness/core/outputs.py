"""Where a command may write: what is there already and is not its own work stays as it is."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from harness.core.protocol.errors import InputError


def file_to_write(path: Path, option: str, ours: Callable[[Path], bool], work: str) -> Path:
    """The file ``path`` of the option ``option``, asked before anything is computed.

    Its folder is made. One that is there already is replaced only if ``ours`` says that it is
    ``work`` ("a picture of harness material preview").

    Raises:
        InputError: no name, a folder, another's file, or a place that cannot be written to.
    """
    folder_to_write_to(path.parent, option, path)
    if path == Path() or path.is_dir():
        raise InputError(f"{option} {_shown(path)}: expected a file")
    if os.path.lexists(path) and not (path.is_file() and _asked(ours, path)):
        raise InputError(
            f"{option} {path}: is there already and is not {work}; it stays as it is:"
            " choose another name"
        )
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"{option} {path}: cannot be written: no permission")
    return path


def folder_to_fill(path: Path, option: str, ours: Callable[[Path], bool], work: str) -> Path:
    """The folder ``path``, which is made, for files of a command.

    One that holds something is used only if ``ours`` says that it is ``work``.

    Raises:
        InputError: no name, a file, another's folder, or one that cannot be written to.
    """
    if path == Path():
        raise InputError(f"{option}: expected a folder of its own for {work}")
    folder_to_write_to(path, option)
    others = sorted(item.name for item in path.iterdir())
    if others and not _asked(ours, path):
        raise InputError(
            f"{option} {path}: holds other things than {work} ({', '.join(others[:3])}"
            f"{', ...' if len(others) > 3 else ''}); expected an empty or a new folder"
        )
    if not os.access(path, os.W_OK):
        raise InputError(f"{option} {path}: cannot be written: no permission")
    return path


def folder_to_write_to(folder: Path, option: str, named: Path | None = None) -> None:
    """Make a folder; ``named`` is what messages name, by default the folder itself."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{option} {named or folder}: cannot be written: {error.strerror}"
        ) from None


def _asked(ours: Callable[[Path], bool], path: Path) -> bool:
    try:
        return ours(path)
    except Exception:  # whatever a reader of other files stumbles over
        return False  # what cannot be read is nobody's to replace


def _shown(path: Path) -> str:
    return "''" if path == Path() else str(path)
