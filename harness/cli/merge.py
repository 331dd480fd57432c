"""``harness merge A B --out C``: results of one suite from several folders in one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def merge(
        folders: Annotated[list[Path], typer.Argument(help="Folders that harness run wrote.")],
        out: Annotated[Path, typer.Option(help="A new folder for all of it.")],
    ) -> None:
        """Put results of one suite together: parts of it, or those of a colleague.

        What several have is taken of the first. Times of other machines than the first one's keep
        their machine in the label of the method.
        """
        from harness.core.protocol.errors import InputError
        from harness.store.merge import merge as merged

        if len(folders) < 2:
            raise InputError("merge: expected two folders or more")
        for folder in folders:
            if not folder.is_dir():
                raise InputError(f"no such folder: {folder}")
        found = merged(folders, out)
        for folder, count in found.taken.items():
            print(f"{folder}: {count} trial{'' if count == 1 else 's'} taken")
        for folder, keys in found.conflicts.items():
            more = ", ..." if len(keys) > 3 else ""
            print(
                f"{folder}: {len(keys)} with other numbers than before, left: "
                f"{', '.join(keys[:3])}{more}"
            )
        for machine, count in found.elsewhere.items():
            print(f"{count} of another machine, kept apart: {machine}")
