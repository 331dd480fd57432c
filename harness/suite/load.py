"""Reads a suite from YAML and refuses, in one line, what it cannot mean."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from harness.core.paths import SUITES
from harness.core.plain import check_plain
from harness.core.protocol.errors import InputError, Mistakes, nearest
from harness.core.refusal import refusals
from harness.core.text import printable
from harness.core.yamlfile import parse_yaml, read_text, read_yaml
from harness.suite.made_by import sorted_out
from harness.suite.material_folders import spread
from harness.suite.schema import MethodSpec, NamedSpec, Suite
from harness.suite.sweep import expand
from harness.suite.tuned import with_tuned

LISTS = ("materials", "methods", "scenes", "measures")
# Entries that name a file: our own 'file' and 'environment', and Mitsuba's 'filename'.
FILE_KEYS = ("file", "filename", "environment")


@dataclass(frozen=True)
class Loaded:
    """A valid suite, where it came from and its text.

    ``left_out`` are materials whose file is not there: by name, the command that makes it.
    """

    suite: Suite
    path: Path
    text: str
    left_out: dict[str, str] = field(default_factory=dict)


def names() -> list[str]:
    """Names of the suites that come with the harness."""
    return sorted(path.stem for path in SUITES.glob("*.yaml"))


def describe(name: str) -> str:
    """Title of a suite that comes with the harness."""
    data = read_yaml(SUITES / f"{name}.yaml", "a suite in YAML")
    return str(data.get("title", ""))


def find(name: str | Path) -> Path:
    """The file of a suite given by path or by its bare name."""
    path = Path(name)
    if path.is_file():
        return path
    bare = SUITES / f"{name}.yaml"
    if path.name == str(name) and bare.is_file():
        return bare  # also where a folder has that name, such as one of files of the suite's
    if path.is_dir():
        raise InputError(f"{name}: is a directory; expected a suite, a .yaml file")
    beside = [item.name for item in path.parent.glob("*.yaml")] if path.suffix else []
    known = beside if path.suffix else names()
    raise InputError(f"no such suite: {name}{nearest(path.name, known)}")


def load(name: str | Path, tuned: bool = True) -> Loaded:
    """Read and check a suite. References to registries are resolved later, all at once.

    Without ``tuned``, parameters that are found by ``harness tune`` are left out.
    """
    path = find(name)
    text = read_text(path, "a suite in YAML")
    return checked(parse_yaml(text, str(path)), path, text, tuned)


def from_data(data: Any) -> Loaded:
    """A suite from a dictionary, as YAML would give it. Files are meant from the working folder."""
    name = data.get("name") if _is_map(data) else None
    # Not a file; what is said of the suite begins with it.
    where = f"suite {printable(repr(name), '')[:100]}"
    check_plain(data, where)
    return checked(copy.deepcopy(data), Path(where), yaml.safe_dump(data))


def checked(data: Any, path: Path, text: str, tuned: bool = True) -> Loaded:
    """The suite that ``data`` describes; ``path`` is what messages call it, ``text`` is kept.

    ``data`` is plain (:mod:`harness.core.plain`) and may be written to. See :func:`load` for
    ``tuned``.
    """
    try:
        return _checked(data, path, text, tuned)
    except OSError as error:  # a name of a file that no file can have, a folder that is not ours
        raise InputError(f"{path}: {error.filename}: {error.strerror}") from None


def _checked(data: Any, path: Path, text: str, tuned: bool) -> Loaded:
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a mapping with the keys name, materials, methods, ...")
    try:
        named = spread(data.get("materials"), lambda f: _absolute(f, path.parent))
        data["materials"], left_out = sorted_out(named, lambda f: _absolute(f, path.parent))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    for key in LISTS:
        if isinstance(data.get(key), list):
            data[key] = [{"name": x} if isinstance(x, str) else x for x in data[key]]
    if isinstance(data.get("scenes"), list):
        # A file has a name of its own.
        data["scenes"] = [
            {"name": Path(x["file"]).stem} | x
            if _is_map(x) and "name" not in x and isinstance(x.get("file"), str)
            else x
            for x in data["scenes"]
        ]
    for profile in (data.get("profiles") or {}).values() if _is_map(data.get("profiles")) else ():
        if _is_map(profile) and _is_map(profile.get("measures")):
            # `equal-spp:` with nothing after it is a measure with its own settings.
            profile["measures"] = {
                k: {} if v is None else v for k, v in profile["measures"].items()
            }
    try:
        suite = Suite.model_validate(data)
    except ValidationError as error:
        raise Mistakes(f"{path}: {line}" for line in refusals(Suite, error)) from None
    mistakes: list[str] = []
    for spec in [*suite.materials, *suite.scenes]:
        _noted(mistakes, lambda s=spec: _locate_files([s], path.parent))
    for index, method in enumerate(suite.methods):
        _noted(mistakes, lambda i=index, m=method: _label(i, m, path.parent))
    if not mistakes:
        extra = path.parent / suite.tuned if tuned and suite.tuned else None
        _noted(mistakes, lambda: _finish(suite, extra, left_out))
    if mistakes:
        raise Mistakes(f"{path}: {line}" for line in mistakes)
    return Loaded(suite, path, text, left_out)


def _finish(suite: Suite, tuned: Path | None, left_out: Iterable[str]) -> None:
    for part in [*suite.measures, *suite.profiles.values()]:
        if part.materials is not None:
            part.materials = [name for name in part.materials if name not in left_out]
    if tuned is not None:
        suite.methods = with_tuned(suite.methods, tuned)
    suite.methods = expand(suite.methods)
    _give_parameters(suite)
    _check_references(suite)


def _noted(mistakes: list[str], check: Callable[[], None]) -> None:
    """Run ``check``; what it refuses is one more of the mistakes."""
    try:
        check()
    except InputError as error:
        mistakes.append(str(error))


def _label(index: int, spec: MethodSpec, folder: Path) -> None:
    """Make the path of an adapter absolute and give the method its label."""
    from harness.core import registry

    file, colon, cls = spec.name.rpartition(":")
    if file.endswith(".py"):
        spec.name = f"{_absolute(file, folder)}{colon}{cls}"
    try:
        name = registry.find(spec.name).name
    except InputError as error:
        raise InputError(f"methods[{index}]: {error}") from None
    if not spec.label:
        shown = " ".join(f"{key}={value}" for key, value in sorted(spec.params.items()))
        spec.label = f"{name} ({shown})" if shown else name


def _locate_files(specs: list[NamedSpec], folder: Path) -> None:
    """Make the files that materials and scenes name absolute; they must be there."""
    for spec in specs:
        for key, value in spec.rest().items():
            setattr(spec, key, _with_files(value, key, folder, spec.name))


def _with_files(value: Any, key: str, folder: Path, owner: str) -> Any:
    if isinstance(value, dict):
        return {k: _with_files(v, k, folder, owner) for k, v in value.items()}
    if isinstance(value, list):
        return [_with_files(v, key, folder, owner) for v in value]
    if not isinstance(value, str):
        return value
    file, colon, cls = value.rpartition(":")
    if key == "type" and file.endswith(".py"):  # a Mitsuba plugin of the user's own
        return f"{_absolute(file, folder)}{colon}{cls}"
    if key not in FILE_KEYS:
        return value
    path = Path(_absolute(value, folder))
    if not path.is_file():
        beside = [item.name for item in path.parent.glob(f"*{path.suffix}")]
        hint = nearest(path.name, beside) if beside else ""
        raise InputError(f"'{owner}': {key}: no such file: {value}{hint}")
    try:
        path.open("rb").close()
    except OSError as error:
        raise InputError(f"'{owner}': {key}: {value} cannot be read: {error.strerror}") from None
    return str(path)


def _give_parameters(suite: Suite) -> None:
    """Hand the suite's ``parameters`` to the XML files that have them; each to one at least."""
    if not suite.parameters:
        return
    from harness.mitsuba_runtime import mitsuba_xml

    used: set[str] = set()
    for spec in [*suite.materials, *suite.scenes]:
        file = spec.rest().get("file")
        if not isinstance(file, str) or Path(file).suffix != ".xml":
            continue
        own = spec.rest().get("parameters", {})
        found = mitsuba_xml.used(Path(file), f"'{spec.name}'", suite.parameters)
        used |= set(found)
        if found and _is_map(own):
            spec.parameters = {key: suite.parameters[key] for key in found} | own
    for key in suite.parameters:
        if key not in used:
            raise InputError(f"parameters: no XML file of this suite has '${key}'")


def _absolute(file: str, folder: Path) -> str:
    """Relative to the suite's folder if it is there, else to the current one."""
    path = Path(file).expanduser()
    beside = folder / path
    return str((beside if beside.exists() else path).resolve())


def _check_references(suite: Suite) -> None:
    """Labels are unique, and what the suite says of its own entries exists."""
    labels = {
        "materials": [item.name for item in suite.materials],
        "methods": [item.label for item in suite.methods],
        "scenes": [item.name for item in suite.scenes],
        "measures": [item.name for item in suite.measures],
        "seeds": suite.seeds,
        "training_seeds": suite.training_seeds or [],
    }
    for name, profile in suite.profiles.items():
        for key in ("seeds", "training_seeds"):
            labels[f"profiles.{name}.{key}"] = getattr(profile, key) or []
    for key, values in labels.items():
        seen: set[Any] = set()
        for index, value in enumerate(values):
            if value in seen:
                more = "; give one of them another label" if key == "methods" else ""
                raise InputError(f"{key}[{index}]: '{value}' is listed twice{more}")
            seen.add(value)
    for index, method in enumerate(suite.methods):
        if method.measures is not None:
            where = f"methods[{index}].measures"
            _known(where, method.measures, labels["measures"], "measure of this suite")
    for index, measure in enumerate(suite.measures):
        for key in ("materials", "scenes"):
            if (chosen := getattr(measure, key)) is not None:
                where = f"measures[{index}].{key}"
                _known(where, chosen, labels[key], f"{key[:-1]} of this suite")
    if suite.baseline is not None:
        _known("baseline", [suite.baseline], labels["methods"], "method of this suite")
        chosen = suite.methods[labels["methods"].index(suite.baseline)]
        if chosen.first_fit_only:
            raise InputError(
                f"baseline: '{suite.baseline}' has first_fit_only; expected a method without,"
                " since fits of all training seeds are compared with it"
            )
    for name, profile in suite.profiles.items():
        for key in ("materials", "methods", "scenes"):
            chosen = getattr(profile, key)
            if chosen is not None:
                _known(f"profiles.{name}.{key}", chosen, labels[key], f"{key[:-1]} of this suite")
        for key, what in (("measures", "measure"), ("override", "method")):
            known = labels[f"{what}s"]
            _known(f"profiles.{name}.{key}", getattr(profile, key), known, f"{what} of this suite")


def _known(where: str, values: Iterable[str], known: list[str], what: str) -> None:
    for value in values:
        if value not in known:
            raise InputError(f"{where}: '{value}' is no {what}{nearest(value, known)}")


def _is_map(value: Any) -> bool:
    return isinstance(value, dict)
