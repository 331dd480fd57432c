"""Text from elsewhere, made fit for one line of a terminal, a table or a page."""

from __future__ import annotations

import unicodedata

_UNSEEN = {"Cc", "Cs", "Zl", "Zp"}
"""Control characters, halves of surrogate pairs, and separators of lines and paragraphs."""
_TURNING = set("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of the text after them."""


def unprintable(character: str) -> bool:
    """Whether it does something to a terminal or a line instead of being seen."""
    return character in _TURNING or unicodedata.category(character) in _UNSEEN


def printable(text: str, keep: str = "\n\t") -> str:
    r"""``text`` with what is not printable written out, as ``\x1b``; ``keep`` stays."""
    if text.isprintable():
        return text
    return "".join(c if c in keep or not unprintable(c) else _written(c) for c in text)


def one_line(text: str) -> str:
    """``text`` without line breaks, printable."""
    return printable(" ".join(text.split()), keep="")


def shortened(text: str, most: int = 1500) -> str:
    """``text`` without its middle where it is longer than ``most`` characters."""
    if len(text) <= most:
        return text
    return f"{text[: 2 * most // 3]} ... {text[-most // 3 :]}"


def _written(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")
