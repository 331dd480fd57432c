"""The text of a Mitsuba XML file, before Mitsuba reads it: is it XML, of a sane size and depth?

Mitsuba's parser goes down into elements by calling itself: ten thousand in one another end the
process. So what a suite or a script names is looked at here first, with all that it includes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from harness.core.protocol.errors import InputError

DEPTH = 256
"""Elements in one another."""
BYTES = 64 * 2**20
"""Of a file; meshes and images are files of their own."""
NAME = 255
"""Bytes of a file's name on any system, without its folders."""
GROWN, _ROUNDS = 2**16, 16
"""Characters that a value may come to once parameters stand in it, and how often they may stand for
others."""
_TEXTS = ("string", "path", "include", "spectrum")
"""Elements whose values may name a file."""


def checked(spec: Any) -> Any:
    """``spec``, of a material or scene, once all XML files in it are found to be sane.

    What is no file is left to whoever reads it.

    Raises:
        InputError: a file is no XML, or too large, too deep or with names that are too long.
    """
    for file in _files(spec):
        check(file)
    return spec


def check(file: Path) -> None:
    """Refuse what :func:`checked` refuses, in ``file`` and what it includes."""
    todo, seen, values = [file], set[Path](), dict[str, str]()
    while todo:
        one = todo.pop()
        if one in seen or not _is_xml(one):
            continue
        seen.add(one)
        root = _root(one)
        for default in root.iter("default"):
            values.setdefault(default.get("name", ""), default.get("value", ""))
        for text in (t for e in root.iter() for t in e.attrib.values() if "$" in t):
            _check_growth(text, values, one)
        for element in (e for tag in _TEXTS for e in root.iter(tag)):
            for text in (element.get("value", ""), element.get("filename", "")):
                if any(len(part.encode("utf-8", "replace")) > NAME for part in text.split("/")):
                    raise InputError(
                        f"{one}: <{element.tag}>: expected a text of at most {NAME} bytes,"
                        f" got '{text[:20]}...' of {len(text):,}"
                    )
        # Names whose parameters the suite gives are not known here, and left to Mitsuba.
        for name in {_expanded(e.get("filename", ""), values) for e in root.iter("include")}:
            _check_file(one.parent / name, one)
            todo.append(one.parent / name)
        for name in {_expanded(e.get("filename", ""), values) for e in root.iter("spectrum")}:
            _check_file(one.parent / name, one)
            _check_text(one.parent / name)


def _check_file(path: Path, named_by: Path) -> None:
    """Refuse a device or pipe, whose end may never come; what is not there is Mitsuba's to say."""
    try:
        other = path.exists() and not (path.is_file() or path.is_dir())
    except (OSError, ValueError):
        return
    if other:
        raise InputError(f"{named_by}: expected the name of a file, got '{path}'")


def _check_text(path: Path) -> None:
    """Refuse a spectrum that is not text: Mitsuba's complaint about it could not be read."""
    try:
        if path.is_file():
            path.read_text("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file") from None
    except (OSError, ValueError):
        return


def _expanded(text: str, values: Mapping[str, str]) -> str:
    """``text`` with parameters in place; :func:`_check_growth` has found that it stays short."""
    for _ in range(_ROUNDS):
        for name in sorted(filter(None, values), key=len, reverse=True):
            text = text.replace(f"${name}", values[name])
    return text


def _check_growth(text: str, values: Mapping[str, str], file: Path) -> None:
    """Refuse a text in which parameters stand for more and more, or for themselves."""
    whole = text
    for _ in range(_ROUNDS):
        before = text
        for name in sorted(filter(None, values), key=len, reverse=True):
            if len(text) + text.count(f"${name}") * len(values[name]) > GROWN:
                raise InputError(
                    f"{file}: '{whole[:40]}': expected at most {GROWN:,} characters once its"
                    " parameters stand in it"
                )
            text = text.replace(f"${name}", values[name])
        if text == before:
            return
    raise InputError(f"{file}: '{whole[:40]}': parameters stand for one another without an end")


def _files(spec: Any) -> Iterator[Path]:
    if isinstance(spec, Mapping):
        for key, value in spec.items():
            if key == "file" and isinstance(value, str):
                yield Path(value)
            else:
                yield from _files(value)


def _is_xml(path: Path) -> bool:
    """Whether it is a file that begins as XML does, in UTF-8 or UTF-16."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(64).lstrip(b"\xef\xbb\xbf\xff\xfe\0 \t\r\n")[:1] == b"<"
    except OSError:
        return False  # whoever reads it will say so


def _root(path: Path) -> Element:
    if path.stat().st_size > BYTES:
        raise InputError(f"{path}: expected at most {BYTES:,} bytes of XML")
    found, depth = None, 0
    try:
        for event, element in ElementTree.iterparse(path, ("start", "end")):
            found = element if found is None else found
            depth += 1 if event == "start" else -1
            if depth > DEPTH:
                break
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        # The two others are of an encoding that is not known.
        raise InputError(f"{path} is not XML: {error}") from None
    if depth > DEPTH:
        raise InputError(f"{path}: expected at most {DEPTH} elements in one another")
    assert found is not None  # else there was no XML
    return found
