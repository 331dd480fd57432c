"""The mark inside a PNG of a command, by which it may be replaced by a newer one."""

from __future__ import annotations

from pathlib import Path

MARK = {"Software": "harness"}
"""For ``metadata`` of matplotlib's ``savefig`` and ``imsave``."""


def marked(path: Path) -> bool:
    """Whether a PNG has the mark.

    Raises:
        OSError: it is no picture.
    """
    from PIL import Image

    with Image.open(path) as picture:
        return picture.info.get("Software") == MARK["Software"]
