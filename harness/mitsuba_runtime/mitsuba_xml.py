"""Mitsuba's XML files, read without Mitsuba: what is in them, and what determines them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from harness.core.protocol.errors import InputError


def read(path: Path, where: str) -> Element:
    """Root element of the file.

    Raises:
        InputError: no such file, not readable, not XML, or no Mitsuba file; ``where`` names
            what the file was given for.
    """
    if not path.is_file():
        raise InputError(f"{where}: no such file: {path}")
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None
    except ElementTree.ParseError as error:
        raise InputError(f"{where}: {path} is not XML: {error}") from None
    if root.get("version") is None:
        raise InputError(
            f"{where}: {path} is no Mitsuba file: its root <{root.tag}> has no version"
        )
    return root


def bsdf_ids(root: Element) -> list[str]:
    """The ids of all BSDFs of the file, in its order."""
    return [e.get("id", "") for e in root.iter("bsdf") if e.get("id")]


def file_values(root: Element, path: Path) -> Iterator[tuple[Element, str, Path]]:
    """Every file that the XML at ``path`` names: ``(element, attribute, file)``.

    ``$name`` is replaced by the file's own ``<default>``; a relative name is meant from the
    XML's folder. Files need not exist.
    """
    defaults = {e.get("name", ""): e.get("value", "") for e in root.iter("default")}

    def expanded(text: str) -> str:
        return re.sub(r"\$(\w+)", lambda m: defaults.get(m[1], m[0]), text)

    for element in root.iter():
        if element.tag == "string" and element.get("name") == "filename":
            yield element, "value", path.parent / expanded(element.get("value", ""))
        elif element.tag == "include":
            yield element, "filename", path.parent / expanded(element.get("filename", ""))


def content_hash(path: Path, where: str) -> str:
    """SHA-256 of what the XML says, with every file it names by content instead of by name.

    Raises:
        InputError: as :func:`read`, or a file that it names is missing.
    """
    root = read(path, where)
    for element, attribute, file in file_values(root, path):
        element.set(attribute, file_hash(file, f"{where}: {path.name}"))
    canonical = ElementTree.canonicalize(
        ElementTree.tostring(root, encoding="unicode"), strip_text=True
    )
    return hashlib.sha256(canonical.encode()).hexdigest()


def file_hash(path: Path, where: str) -> str:
    """SHA-256 of a file's bytes; an :class:`InputError` if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise InputError(f"{where}: no such file: {path}") from None
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None
