"""The three sizes of every scene: how finely shapes and maps are made, not how it is framed."""

from __future__ import annotations

from typing import Literal, get_args

Size = Literal["small", "medium", "large"]
SIZES: tuple[str, ...] = get_args(Size)
SCALE: dict[str, float] = {"small": 0.5, "medium": 1.0, "large": 2.0}
"""Rows of a mesh or a map over those of the medium size."""
