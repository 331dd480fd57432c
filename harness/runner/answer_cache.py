"""Output of commands that had nothing to do, kept for when they are given again.

To plan a suite, torch and Mitsuba are imported, which takes seconds; to find out that nothing has
changed since, a tenth of one. The answer is kept in the user's cache folder under the digest of
all that it was made of: the command, the suite's text, every file of this package, what is
installed, the environment, the machine, its compiler and kernels, and the stored results.

A suite that names anything but what comes with the harness by name is never answered so: which
files its files name in turn, only a plan finds out.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from harness.core import machine
from harness.core.cache_folder import cache_folder
from harness.core.compiled.build import compiler
from harness.core.paths import ROOT, SUITES

FOLDER = "answers"
_MOST = 200
"""Answers that are kept; with more, the oldest go."""
_NAME = re.compile(r"[\w ()=,+-]*")
"""What names no file: without a dot and a separator."""
_FILES = {"file", "filename", "environment", "folder", "tuned"}
"""Keys of a suite whose values are files, however they are written."""
enabled = True
"""Whether answers are kept and given."""


class AnswerCache:
    """Answers of one command about one suite and one results folder."""

    def __init__(
        self,
        command: Mapping[str, Any],
        suite: str,
        out: Path | None = None,
        stored: bool = True,
    ):
        """``command`` is its name and options, as JSON data; ``out`` a results folder, by default
        that of the suite. Without ``stored`` the answer does not depend on results."""
        self._package, self._made_of, self.results = "", None, out or Path("results")
        self._stored = stored
        if enabled:
            with contextlib.suppress(OSError, ValueError):
                self._look(command, suite, out)

    def _look(self, command: Mapping[str, Any], suite: str, out: Path | None) -> None:
        given = Path(suite)
        file = given if given.is_file() else SUITES / f"{suite}.yaml"
        text = file.read_bytes()
        data = _parsed(text)
        if data is None or not _is_ours_alone():
            return
        self.results = out or Path("results") / str(data.get("name"))
        self._package = _package()
        about = [
            *(dict(command), suite, str(file.resolve()), hashlib.sha256(text).hexdigest()),
            *(self._package, sorted(os.environ.items()), os.getcwd(), _installed(), _kernels()),
            *(sys.executable, sys.version, sys.path, platform.uname()[:5], machine.identity()),
        ]
        self._made_of = hashlib.sha256(json.dumps(about).encode()).hexdigest()

    def disable(self) -> None:
        """Neither keep nor find."""
        self._made_of = None

    def find(self) -> dict[str, Any] | None:
        """What :meth:`keep` was given where all was as it is now; None if nothing was kept."""
        if self._made_of is None:
            return None
        try:
            found = json.loads(self._file().read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) else None

    def keep(self, answer: Mapping[str, Any]) -> None:
        """Keep JSON data; nothing happens if that cannot be done."""
        if self._made_of is None:
            return
        with contextlib.suppress(OSError):
            if _package() != self._package:
                return  # edited meanwhile
            file = self._file()
            file.parent.mkdir(parents=True, exist_ok=True)
            temporary = file.with_name(f".{file.stem}-{os.getpid()}")
            temporary.write_text(json.dumps(answer), "utf-8")
            os.replace(temporary, file)
            kept = sorted(file.parent.glob("*.json"), key=lambda path: path.stat().st_mtime)
            for old in kept[:-_MOST]:
                old.unlink()

    def _file(self) -> Path:
        whole = [self._made_of]
        if self._stored:
            whole += [str(self.results), *_contents(_stored(self.results))]
        digest = hashlib.sha256(json.dumps(whole).encode()).hexdigest()[:32]
        return cache_folder() / FOLDER / f"{digest}.json"


def _is_ours_alone() -> bool:
    """Whether no other package brings methods: its files are not looked at."""
    points = entry_points(group="harness.methods")
    return all(point.value.startswith(("harness.", "harness:")) for point in points)


def _parsed(text: bytes) -> dict[str, Any] | None:
    """A suite, if no text in it could be the name of a file."""
    import yaml

    try:
        data = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, RecursionError, ValueError):
        return None
    plain = isinstance(data, dict) and all(k == "title" or _plain(k, v) for k, v in data.items())
    return data if plain else None


def _plain(key: Any, value: Any) -> bool:
    if isinstance(key, str) and key in _FILES:
        return False
    if isinstance(value, dict):
        return all(_plain(inner, item) for inner, item in value.items())
    if isinstance(value, list):
        return all(_plain("", item) for item in value)
    return not isinstance(value, str) or _NAME.fullmatch(value) is not None


def _package() -> str:
    """Digest of every file of this package, wherever links lead."""

    def files() -> Iterator[Path]:
        for folder, inside, names in os.walk(ROOT / "harness", followlinks=True):
            inside[:] = sorted(name for name in inside if name != "__pycache__")
            yield from (Path(folder) / name for name in sorted(names))

    return hashlib.sha256(json.dumps([*_contents(files())]).encode()).hexdigest()


def _stored(results: Path) -> Iterator[Path]:
    """The files of a results folder, but for its report."""
    if not results.is_dir():
        return
    for path in sorted(results.iterdir()):
        if path.is_file():
            yield path
    yield from sorted(path for path in (results / "files").glob("*") if path.is_file())


def _contents(files: Iterable[Path]) -> Iterator[tuple[str, str]]:
    for path in files:
        with path.open("rb") as file:
            yield str(path), hashlib.file_digest(file, "sha256").hexdigest()


def _installed() -> list[str]:
    """Names of what says which distributions there are, and in which versions."""
    found = []
    for place in sys.path:
        with contextlib.suppress(OSError):
            found += [name for name in os.listdir(place or ".") if name.endswith((".dist-info",
                      ".egg-info", ".egg-link", ".pth"))]  # fmt: skip
    return sorted(found)


def _kernels() -> list[Any]:
    """The compiler that there is, and what was compiled already or could not be."""
    path = compiler()
    found: list[Any] = [path, Path(path).stat().st_mtime_ns if path else 0]
    for folder, _, names in os.walk(cache_folder()):
        if Path(folder).name != FOLDER:
            found += sorted(
                (name, Path(folder, name).stat().st_size) for name in names if "units-" not in name
            )
    return found
