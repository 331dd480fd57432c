"""The content of files that a specification names, and one digest for all of them.

A file counts by what is in it and not by its name: an XML file is compared without comments and
layout, and with every listed file that it names by content instead of by name. Others by bytes.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from harness.core.protocol.errors import InputError

LENGTH = 16
_LONGEST = 1024
"""Characters; a longer text names no file."""


@dataclass(frozen=True)
class FilesDigest:
    """``digest`` of the content of files, and each one's own by the name it is known by."""

    digest: str
    files: Mapping[str, str] = field(repr=False)


def digest_of(files: Iterable[Path]) -> FilesDigest:
    """Digest of ``files`` as a set of contents; neither order nor place counts.

    Raises:
        InputError: a file that is missing or cannot be read.
    """
    paths = sorted({path.resolve() for path in files})
    reader = _Reader(frozenset(paths))
    found: dict[str, str] = {}
    for path in paths:
        name = path.name
        while name in found:
            name += "'"
        found[name] = reader.of(path)
    text = "\n".join(sorted(found.values()))
    return FilesDigest(hashlib.sha256(text.encode()).hexdigest()[:LENGTH], found)


def named_in(value: Any, base: Path) -> Iterator[Path]:
    """Files that texts anywhere in ``value`` (JSON data) name, as seen from the folder ``base``.

    A text counts if it has a separator or a dot and there is such a file; of a folder every file
    in it. A method's parameter may name its weights, a database or a configuration.
    """
    if isinstance(value, Mapping):
        for item in value.values():
            yield from named_in(item, base)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from named_in(item, base)
    elif isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        if 0 < len(text) <= _LONGEST and ("." in text or os.sep in text) and "\0" not in text:
            yield from _files_at(base / Path(text).expanduser())


def _files_at(path: Path) -> Iterator[Path]:
    try:
        if path.is_file():
            yield path
        elif path.is_dir() and path.name not in ("", ".", ".."):
            yield from (file for file in sorted(path.rglob("*")) if file.is_file())
    except OSError:
        return  # a text that no file system takes as a name


class _Reader:
    def __init__(self, listed: frozenset[Path]):
        self.listed = listed
        self.open: set[Path] = set()

    def of(self, path: Path) -> str:
        try:
            stamp = path.stat()
            digest = _bytes_digest(path, stamp.st_mtime_ns, stamp.st_size)
            if path.suffix.lower() != ".xml" or path in self.open:
                return digest
            root = ElementTree.fromstring(path.read_bytes())
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        except ElementTree.ParseError:
            return digest  # whoever reads it as XML will say what is wrong
        self.open.add(path)
        self._replace(root, path)
        self.open.discard(path)
        text = ElementTree.canonicalize(
            ElementTree.tostring(root, encoding="unicode"), strip_text=True
        )
        return hashlib.sha256(text.encode()).hexdigest()[:LENGTH]

    def _replace(self, root: ElementTree.Element, path: Path) -> None:
        """Names of listed files in attributes by the files' content."""
        defaults = {e.get("name", ""): e.get("value", "") for e in root.iter("default")}
        for element in root.iter():
            for key, value in element.attrib.items():
                text = re.sub(r"\$(\w+)", lambda m: defaults.get(m[1], m[0]), value)
                if not text or len(text) > _LONGEST:
                    continue
                target = Path(os.path.normpath(path.parent / text))
                if target in self.listed or target.resolve() in self.listed:
                    element.set(key, self.of(target.resolve()))


@lru_cache(maxsize=1024)
def _bytes_digest(path: Path, stamp: int, size: int) -> str:
    """SHA-256 of a file's bytes; remembered until time stamp or size change."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:LENGTH]


def replaced(value: Any, base: Path) -> Any:
    """A copy of JSON data in which the content of files stands for their names.

    See :func:`named_in` for what counts as the name of a file or folder.
    """
    if isinstance(value, Mapping):
        return {key: replaced(item, base) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [replaced(item, base) for item in value]
    files = list(named_in(value, base))
    return {"content": digest_of(files).digest} if files else value
