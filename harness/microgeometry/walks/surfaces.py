"""Finds surfaces for walks: the descriptions that come with the harness, reliefs, files."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from harness.core.yamlfile import read_yaml
from harness.microgeometry import descriptions
from harness.microgeometry.walks.description import is_walked, read
from harness.microgeometry.walks.micro import MicroBSDF
from harness.microgeometry.walks.surface import WalkedSurface


@cache
def names() -> tuple[str, ...]:
    """Names of the described beds and facet fields that come with the harness, sorted."""
    return tuple(name for name in descriptions.names() if is_walked(_data(name)))


def reliefs() -> tuple[str, ...]:
    """Names of the other descriptions: displaced, textured surfaces, which are path-traced too."""
    return tuple(name for name in descriptions.names() if name not in names())


def about(name: str) -> str:
    """One line about a description that comes with the harness."""
    return str(_data(name).get("about", ""))


def load(name: str | Path, resolution: int | None = None) -> WalkedSurface:
    """The surface of a description, given by file or by name.

    A relief (`relief:` instead of `primitives:` or `facets:`) is walked on with the BSDF that it
    is path-traced with, on ``resolution``^2 texels (or its own).

    Raises:
        InputError: one line that names the file and key.
    """
    file = descriptions.find(name)
    if file.suffix != ".yaml" or is_walked(read_yaml(file, "a description in YAML")):
        return read(file)
    relief = descriptions.load(file, resolution)
    micro = MicroBSDF(relief.bsdf, where="bsdf")
    text = str(read_yaml(file, "a description in YAML").get("about", ""))
    return WalkedSurface(relief.name, text, relief, micro, micro, source=relief.identity())


def _data(name: str) -> dict:
    return read_yaml(descriptions.find(name), "a description in YAML")
