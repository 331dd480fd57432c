"""The named scenes. A function's keyword arguments are what a suite may set."""

from __future__ import annotations

from collections.abc import Callable

from harness.geometry.primitives import Sphere
from harness.geometry.shapes import cloth_mesh
from harness.scenes.base import Camera, Scene
from harness.scenes.environment import open_shade, studio
from harness.scenes.patches import bent_quad, close_up, quad
from harness.scenes.shelf import shelf
from harness.scenes.sizes import SCALE, Size
from harness.scenes.still_life import table_still_life

EFFECTS = ("environment",)

# Just wide enough for the unit sphere, which spans 2 asin(1 / 4) = 28.96 degrees.
_AT_SPHERE = Camera(origin=(0.0, 0.0, 4.0), target=(0.0, 0.0, 0.0), fov=29.6)
_AT_CLOTH = Camera(origin=(0.0, 0.0, 5.0), target=(0.0, 0.0, 0.0), fov=24.0)


def _sphere(texture_repeat: float, size: Size) -> Sphere:
    # A full turn of u is twice as long as v from pole to pole.
    scale = (2 * texture_repeat, texture_repeat)
    return Sphere(uv_scale=scale, rows=int(96 * SCALE[size]))


def _map(size: Size) -> dict[str, int]:
    return {"height": int(128 * SCALE[size]), "width": int(256 * SCALE[size])}


def uniform_sphere(
    radiance: float = 1.0, texture_repeat: float = 2.0, size: Size = "medium"
) -> Scene:
    """Sphere in constant light: only the BSDF shapes the integrand."""
    return Scene(
        "uniform-sphere",
        EFFECTS,
        (_sphere(texture_repeat, size),),
        radiance,
        _AT_SPHERE,
        "a sphere in constant light",
    )


def studio_sphere(texture_repeat: float = 2.0, size: Size = "medium") -> Scene:
    """Sphere in a photographer's studio: small bright lamps in a dim room."""
    return Scene(
        "studio-sphere",
        EFFECTS,
        (_sphere(texture_repeat, size),),
        studio(**_map(size)),
        _AT_SPHERE,
        "a sphere under studio softboxes",
    )


def draped_cloth(texture_repeat: float = 2.0, size: Size = "medium") -> Scene:
    """Draped cloth in open shade: broad light and one low, hazy sun."""
    return Scene(
        "draped-cloth",
        EFFECTS,
        (cloth_mesh(texture_repeat, int(160 * SCALE[size])),),
        open_shade(**_map(size)),
        _AT_CLOTH,
        "a hanging cloth in open shade",
    )


def uniform_cloth(
    radiance: float = 1.0, texture_repeat: float = 2.0, size: Size = "medium"
) -> Scene:
    """Draped cloth in constant light."""
    return Scene(
        "uniform-cloth",
        EFFECTS,
        (cloth_mesh(texture_repeat, int(160 * SCALE[size])),),
        radiance,
        _AT_CLOTH,
        "a hanging cloth in constant light",
    )


SCENES: dict[str, Callable[..., Scene]] = {
    "uniform-sphere": uniform_sphere,
    "studio-sphere": studio_sphere,
    "draped-cloth": draped_cloth,
    "uniform-cloth": uniform_cloth,
    "shelf": shelf,
    "table-still-life": table_still_life,
    "quad": quad,
    "bent-quad": bent_quad,
    "close-up": close_up,
}
