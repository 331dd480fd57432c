"""Where Mitsuba looks for files that are named without a folder."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def beginning_with(folder: Path) -> Iterator[Any]:
    """Have Mitsuba's search path (its ``FileResolver``) begin with ``folder`` in the block."""
    import mitsuba as mi

    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    resolver.prepend(str(folder))
    mi.set_file_resolver(resolver)
    try:
        yield resolver
    finally:
        mi.set_file_resolver(before)
