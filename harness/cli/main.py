"""The ``harness`` command. A verb's file is imported when the verb is used."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import Annotated

import typer

from harness.core.text import one_line

VERBS = (
    *("run", "report", "status", "compare", "advise", "tune"),
    *("list", "check", "validate", "new", "doctor", "bench", "effects"),
    *("fit", "material", "bake", "fuzz", "merge"),
)
FAILED, REFUSED = 1, 2
INTERRUPTED = 130

_OF_THE_MACHINE = (
    errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EACCES, errno.EPERM, errno.EMFILE,
    errno.ENFILE, errno.ENAMETOOLONG, errno.EFBIG, errno.ESTALE,
)  # fmt: skip
"""Errors of a disk or of rights, which no other code would be free of."""

# Typer brings its own Click or uses the installed one, by version; both name it alike.
ClickException = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


def build(verb: str = "") -> typer.Typer:
    """The application with the one ``verb``, or with all of them."""
    app = typer.Typer(
        name="harness",
        help="Compare importance-sampling methods for reflectance functions.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @app.callback()
    def common(
        version: Annotated[
            bool,
            typer.Option("--version", help="Print it.", callback=_version, is_eager=True),
        ] = False,
    ) -> None:
        """Compare importance-sampling methods for reflectance functions."""

    for name in [verb] if verb in VERBS else VERBS:
        import_module(f"harness.cli.{name}").register(app)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status.

    What is printed is printable; an output that cannot be written to is one line and status 1, and
    so is a disk that is full or read-only.
    """
    from harness.core import terminal

    try:
        with terminal.guarded():
            return _carried_out(argv)
    except terminal.OutputLost as error:
        terminal.give_up(sys.stdout)
        return _refuse(f"the output cannot be written: {error}; what was stored is kept", FAILED)


def _carried_out(argv: Sequence[str] | None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    verb = next((word for word in arguments if not word.startswith("-")), "")
    command = typer.main.get_command(build(verb))
    try:
        status = command.main(args=arguments, prog_name="harness", standalone_mode=False)
        return status if isinstance(status, int) else 0
    except ClickException as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            error.show()
            return REFUSED
        context = getattr(error, "ctx", None)
        where = context.command_path if context else "harness"
        return _refuse(f"{where}: {error.format_message()}")
    except (typer.Abort, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        from harness.core.protocol.errors import InputError

        if isinstance(error, InputError):
            return _refuse(str(error))
        if isinstance(error, OSError) and error.errno in _OF_THE_MACHINE:
            place = f"{error.filename}: " if error.filename else ""
            return _refuse(f"{place}{error.strerror}", FAILED)
        raise


def _version(wanted: bool) -> None:
    if wanted:
        from harness import __version__

        print(__version__)
        raise typer.Exit


def _refuse(text: str, status: int = REFUSED) -> int:
    with suppress(OSError, ValueError):  # nobody may be there to be told
        print(f"error: {one_line(text)}", file=sys.stderr, flush=True)
    return status
