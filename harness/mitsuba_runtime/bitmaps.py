"""Texel arrays inside Mitsuba dictionaries."""

from __future__ import annotations

from typing import Any


def with_bitmaps(mi: Any, node: Any) -> Any:
    """A copy of a Mitsuba dictionary whose texel arrays are Mitsuba bitmaps."""
    if not isinstance(node, dict):
        return node
    node = {key: with_bitmaps(mi, value) for key, value in node.items()}
    if node.get("type") == "bitmap" and "array" in node:
        node["bitmap"] = mi.Bitmap(node.pop("array"))
    return node
