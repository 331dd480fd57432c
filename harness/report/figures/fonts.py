"""The figures' font: DejaVu Sans without its tables of layout.

A PDF embeds the letters that it uses. Three quarters of the time that this takes goes into tables
of ligatures and kerning, and a ligature is a letter that a search for "flow" does not find. The
files are kept in matplotlib's cache.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import matplotlib as mpl
from matplotlib.font_manager import FontEntry, fontManager

_FROM = "DejaVu Sans"
_NAME = "DejaVu Sans without layout"
_DROPPED = ("GSUB", "GPOS", "GDEF", "MATH", "kern")


@cache
def family() -> list[str]:
    """Names of the font for matplotlib, the best first; the fonts are made where they are not."""
    folder = Path(mpl.get_data_path())
    for entry in list(fontManager.ttflist):
        if entry.name == _FROM and Path(entry.fname).is_relative_to(folder):
            fontManager.ttflist.append(_plain(entry))
    return [_NAME, _FROM]


def _plain(entry: FontEntry) -> FontEntry:
    from fontTools.ttLib import TTFont

    source = Path(entry.fname)
    made = Path(mpl.get_cachedir()) / f"{source.stem}-{source.stat().st_size}-harness.ttf"
    if not made.is_file():
        # The time that it was made would be in the file, and so in what is made with it.
        with TTFont(source, recalcTimestamp=False) as font:
            for table in _DROPPED:
                if table in font:
                    del font[table]
            part = made.with_suffix(f".{os.getpid()}.part")
            font.save(part)
        part.replace(made)
    return replace(entry, fname=str(made), name=_NAME)
