"""The figures' font: letters of DejaVu Sans without its tables of layout.

A PDF embeds the letters that it uses. To pick them out of six thousand, and out of the tables of
ligatures and kerning, takes longer than to draw; and a ligature is a letter that a search for
"flow" does not find. The files are kept in matplotlib's cache.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path

import matplotlib as mpl
from matplotlib.font_manager import FontEntry, fontManager

_FROM = "DejaVu Sans"
_NAME = "DejaVu Sans of figures"
_DROPPED = ("GSUB", "GPOS", "GDEF", "MATH", "kern")
_LETTERS = ((0x20, 0x250), (0x370, 0x530), (0x2000, 0x2300))
"""Latin, Greek, Cyrillic, punctuation, sub- and superscripts, arrows and mathematics. Others
are taken from the whole font."""


@cache
def family() -> list[str]:
    """Names of the font for matplotlib, the best first; the fonts are made where they are not."""
    folder = Path(mpl.get_data_path())
    for entry in list(fontManager.ttflist):
        if entry.name == _FROM and Path(entry.fname).is_relative_to(folder):
            fontManager.ttflist.append(_small(entry))
    return [_NAME, _FROM]


def _small(entry: FontEntry) -> FontEntry:
    source = Path(entry.fname)
    made = Path(mpl.get_cachedir()) / f"{source.stem}-{source.stat().st_size}-harness.ttf"
    try:
        if not made.is_file():
            _make(source, made)
    except OSError:  # no place to keep it: the whole font looks the same
        made = source
    return replace(entry, fname=str(made), name=_NAME)


def _make(source: Path, made: Path) -> None:
    from fontTools import subset

    # The time at which it is made would be in it, and so in what is made with it.
    options = subset.Options(recalc_timestamp=False, drop_tables=[*_DROPPED, "FFTM"])
    font = subset.load_font(str(source), options)
    picked = subset.Subsetter(options)
    picked.populate(unicodes=chain.from_iterable(range(*ends) for ends in _LETTERS))
    picked.subset(font)
    part = made.with_suffix(f".{os.getpid()}.part")
    subset.save_font(font, str(part), options)
    part.replace(made)
