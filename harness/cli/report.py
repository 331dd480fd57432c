"""``harness report RESULTS_DIR``: tables, figures and the page, from stored results only."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def report(
        results_dir: Annotated[
            Path, typer.Argument(help="A folder that harness run wrote, or one of several such.")
        ],
        open_it: Annotated[
            bool, typer.Option("--open", help="Show the page in the browser.")
        ] = False,
    ) -> None:
        """Make tables and figures again from what is stored; nothing is computed.

        Of a folder of several results, an index over them, and their own pages where these are
        missing or older than the results.
        """
        from harness.core.protocol.errors import InputError, nearest
        from harness.core.terminal import Screen
        from harness.store.database import OLD_PLAN, file_of, folders_in

        if not results_dir.is_dir():
            beside = [folder.name for folder in folders_in(results_dir.parent)]
            raise InputError(f"no such folder: {results_dir}{nearest(results_dir.name, beside)}")
        console = Screen(highlight=False)

        def say(text: str) -> None:
            console.print(text, soft_wrap=True, markup=False)

        one = file_of(results_dir) is not None or (results_dir / OLD_PLAN).is_file()
        several = not one and bool(folders_in(results_dir))
        page = _index(results_dir, say) if several else _report(results_dir, console, say)
        if open_it:
            import webbrowser

            webbrowser.open(page.resolve().as_uri())


def _report(results_dir: Path, console: object, say: Callable[[str], None]) -> Path:
    from harness.report import write as reports

    loaded = reports.load(results_dir)
    files = loaded.write(say)
    loaded.print(console)
    for file in files:
        say(str(file))
    return files[0]


def _index(place: Path, say: Callable[[str], None]) -> Path:
    from harness.report.page.index import index
    from harness.report.place import write_page

    text = index(place, say)
    page = place / "index.html"
    write_page(page, text, "index")
    say(str(page))
    return page
