"""Microgeometry: small tileable descriptions of displaced, textured surfaces, and their
multi-resolution BTF (the reflectance at a place, for a footprint and two directions)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from harness.core.paths import SUITES
from harness.core.protocol.errors import InputError, nearest

DESCRIPTIONS = SUITES / "materials"
"""Where the descriptions that come with the harness are."""


def names() -> list[str]:
    """Names of the descriptions that come with the harness, sorted."""
    return sorted(path.stem for path in DESCRIPTIONS.glob("*.yaml"))


def find(name: str | Path) -> Path:
    """The file of a description given by path or by its bare name."""
    path = Path(name)
    if path.is_file():
        return path
    bare = DESCRIPTIONS / f"{name}.yaml"
    if path.name == str(name) and bare.is_file():
        return bare
    beside = [item.name for item in path.parent.glob(f"*{path.suffix}")] if path.suffix else names()
    raise InputError(f"no such description: {name}{nearest(path.name, beside)}")


def load(path: str | Path, resolution: int | None = None) -> Any:
    """The surface of a description (its file, or its name) on ``resolution``^2 texels.

    ``resolution`` is a multiple of 4; None takes the description's own. Nothing is loaded
    of Mitsuba before the first query. A ``.btf`` file gives a
    :class:`~harness.microgeometry.measured.MeasuredSurface`, which answers the same queries.

    Raises:
        InputError: one line that names the file, the key, what was expected and, for an
            unknown word, the nearest known one.
    """
    from harness.microgeometry.description import read

    file = find(path)
    if file.suffix == ".btf":
        from harness.microgeometry.measured import MeasuredSurface

        if resolution is not None:
            raise InputError(f"{file}: measured at its own resolution; expected no 'resolution'")
        return MeasuredSurface(file)
    if resolution is not None and (resolution < 16 or resolution % 4):
        raise InputError(f"resolution: expected a multiple of 4 from 16 on, got {resolution}")
    description = read(file)
    try:
        return description.surface(resolution)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
