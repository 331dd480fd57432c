"""Sheets of a material, on which a patch of its microgeometry can be laid (PureSample, Fig. 5)."""

from __future__ import annotations

from harness.geometry.sheets import tiled_sheet
from harness.scenes.base import Camera, Scene
from harness.scenes.environment import studio
from harness.scenes.sizes import SCALE, Size

_CELLS = {"small": 1, "medium": 2, "large": 4}
"""Quads along the side of a tile, which is flat."""
_TILT = 30.0
_CAMERA = Camera(origin=(0.0, 0.0, 6.0), target=(0.0, 0.0, 0.0), fov=20.0)
# The middle of the same sheet, three tiles of sixteen across.
_NEAR = Camera(origin=(0.0, 0.0, 6.0), target=(0.0, 0.0, 0.0), fov=3.6)


def quad(texture_repeat: float = 16.0, size: Size = "medium") -> Scene:
    """Flat square leaning back under studio softboxes: four lamps in a dim room."""
    return _patch("quad", texture_repeat, size, 0.0, _CAMERA, "a flat square")


def bent_quad(texture_repeat: float = 16.0, size: Size = "medium") -> Scene:
    """The same square bent by 120 degrees: every angle of incidence across it."""
    return _patch("bent-quad", texture_repeat, size, 120.0, _CAMERA, "a bent square")


def close_up(texture_repeat: float = 16.0, size: Size = "medium") -> Scene:
    """The middle of the flat square, three copies of the texture across."""
    return _patch("close-up", texture_repeat, size, 0.0, _NEAR, "a part of a flat square")


def _patch(
    name: str, texture_repeat: float, size: Size, bend: float, camera: Camera, about: str
) -> Scene:
    sheet = tiled_sheet(max(1, round(texture_repeat)), bend, _TILT, cells=_CELLS[size])
    light = studio(height=int(128 * SCALE[size]), width=int(256 * SCALE[size]))
    return Scene(name, ("environment",), (sheet,), light, camera, f"{about} under studio softboxes")
