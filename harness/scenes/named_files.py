"""Every file that a specification reads, whatever it is of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.mitsuba_runtime import mitsuba_xml, python_plugins

_PARTS = ("fc1", "b1", "fc2", "b2", "fc3", "b3")
FILE_KEYS = ("file", "filename", "environment")
"""Keys of a suite whose value is the name of a file."""


def named_files(spec: Any, base_dir: Path | str | None = None) -> list[Path]:
    """Files that a material, a scene or a method is made of, absolute, each once, in order.

    ``spec`` is as in a suite: a name, or data of mappings, lists and texts. Files are named under
    one of :data:`FILE_KEYS`, as a plugin ``file.py:Class``, or by any text that is the name of an
    existing file. What a Mitsuba XML file reads itself (``<include>``, meshes, textures, spectra,
    through its ``parameters``) is listed after it. Relative names are meant from ``base_dir``,
    or the working folder. Nothing but XML is opened, and nothing is executed.

    Raises:
        InputError: an XML file that Mitsuba's parser refuses.
    """
    return list(dict.fromkeys(_named(spec, "", {}, Path(base_dir or ""))))


def _named(node: Any, key: str, parameters: Mapping[str, Any], base: Path) -> Iterator[Path]:
    if isinstance(node, Mapping):
        given = node.get("parameters", {})
        for name, value in node.items():
            yield from _named(value, str(name), given if name == "file" else {}, base)
    elif isinstance(node, list | tuple):
        for item in node:
            yield from _named(item, key, {}, base)
    elif isinstance(node, str) and node:
        yield from _of_text(node, key, parameters, base)


def _of_text(text: str, key: str, parameters: Mapping[str, Any], base: Path) -> Iterator[Path]:
    if python_plugins.is_own(text):
        text = str(python_plugins.file_of(text))
    try:
        path = (base / text).expanduser()
        there = path.is_file()
    except (OSError, ValueError):  # too long, or no name that a file can have
        return
    if not there:
        return
    # A name such as "leather" may be that of a file without an end that lies there by chance.
    if key not in FILE_KEYS and not path.suffix:
        return
    if path.suffix == ".xml":
        try:
            yield from mitsuba_xml.read(path, key or "file", parameters).files
            return
        except InputError:
            if key == "file":
                raise
    yield path.resolve()
    for part in _PARTS:
        # One network in several files, of which any one names it.
        if path.name.endswith(f"{part}.npy"):
            start = path.name.removesuffix(f"{part}.npy")
            beside = (path.with_name(f"{start}{other}.npy") for other in _PARTS)
            yield from (other.resolve() for other in beside if other.is_file())
