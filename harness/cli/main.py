"""The ``harness`` command. A verb's file is imported when the verb is used."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated

import typer

VERBS = (
    *("run", "report", "status", "compare", "advise", "tune"),
    *("list", "check", "validate", "new", "doctor", "bench", "effects"),
    *("fit", "material", "bake", "fuzz"),
)
REFUSED = 2
INTERRUPTED = 130

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
    """Run the command line; returns the exit status."""
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
        raise


def _version(wanted: bool) -> None:
    if wanted:
        from harness import __version__

        print(__version__)
        raise typer.Exit


def _refuse(text: str) -> int:
    print(f"error: {' '.join(text.split())}", file=sys.stderr)
    return REFUSED
