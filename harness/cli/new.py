"""``harness new method NAME``: an adapter that already runs, and its test."""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Annotated

import typer

NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
TAKEN_CLASSES = ("Method", "DiskSample", "Tensor")
"""Names that the template imports; a class of the same name would hide one."""


@dataclass(frozen=True)
class Scaffold:
    """The files written for a new method, and how to name it on the command line."""

    method_file: Path
    test_file: Path
    handle: str


def class_name(name: str) -> str:
    """``my-sampler`` -> ``MySampler``."""
    return "".join(part.capitalize() for part in name.split("-"))


def scaffold(name: str, out: Path) -> Scaffold:
    """Write ``out/methods/<name>.py`` and ``out/tests/test_<name>.py``; replaces nothing."""
    from harness.core import registry

    _check_name(name, registry.names())
    stem = name.replace("-", "_")
    method_file = out / "methods" / f"{stem}.py"
    test_file = out / "tests" / f"test_{stem}.py"
    title = name.replace("-", " ").capitalize()
    fields = {"name": name, "class_name": class_name(name), "title": title, "stem": stem}
    _write(
        {
            method_file: _filled("method.py.txt", fields),
            test_file: _filled("test_method.py.txt", fields),
        }
    )
    shipped = method_file.parent.resolve() == registry.METHODS.resolve()
    handle = name if shipped else f"{method_file}:{fields['class_name']}"
    return Scaffold(method_file, test_file, handle)


def _check_name(name: str, known: list[str]) -> None:
    from harness.core.protocol.errors import InputError

    if not NAME.fullmatch(name):
        raise InputError(
            f"method name '{name}': expected lower-case words of letters and digits, "
            "joined by '-', as in 'my-sampler'"
        )
    if keyword.iskeyword(name) or class_name(name) in TAKEN_CLASSES:
        raise InputError(f"method name '{name}' has a meaning of its own in Python or here")
    if name in known:
        raise InputError(f"method name '{name}' is taken: see harness list methods")


def _filled(template: str, fields: dict[str, str]) -> str:
    text = (resources.files("harness.cli.templates") / template).read_text(encoding="utf-8")
    return Template(text).substitute(fields)


def _write(texts: dict[Path, str]) -> None:
    """Write all files, or none if one of them exists already."""
    from harness.core.protocol.errors import InputError

    for path in texts:
        if path.exists():
            raise InputError(f"{path} exists already and stays as it is; choose another name")
    for path, text in texts.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # 'x': a file that has come into being meanwhile is not replaced either.
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror}") from error


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""
    new = typer.Typer(help="Start something of your own.", no_args_is_help=True)
    app.add_typer(new, name="new")

    @new.command("method")
    def method(
        name: Annotated[str, typer.Argument(help="Its name, such as my-sampler.")],
        out: Annotated[
            Path, typer.Option(help="Folder that gets methods/ and tests/; by default this one.")
        ] = Path(),
    ) -> None:
        """Write an adapter that already runs, and its test."""
        made = scaffold(name, out)
        print(f"wrote {made.method_file}")
        print(f"wrote {made.test_file}")
        print(f"next: harness check {made.handle}")
        print(f"      pytest {made.test_file}")
