"""Environment maps of a user's own: pictures in OpenEXR, Radiance's HDR or PFM."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from harness.core.protocol.errors import InputError
from harness.scenes.base import Array, Scene

SUFFIXES = (".exr", ".hdr", ".pfm")


def path_of(spec: Mapping[str, Any], base_dir: Path | str | None) -> Path:
    """The file that a scene's specification names under ``environment``."""
    value = spec["environment"]
    if not isinstance(value, str) or not value:
        raise InputError(f"scene: environment: expected the name of a picture, got {value!r}")
    return Path(base_dir or "") / value


def applied(scene: Scene, path: Path) -> Scene:
    """The scene in the light of the picture instead of its own environment.

    Raises:
        InputError: no such picture, or the scene calls for no environment.
    """
    where = f"scene '{scene.name}': environment"
    kept = any(effect.partition(":")[0] in ("environment", "auto") for effect in scene.effects)
    if not kept:
        raise InputError(
            f"{where}: the scene's effects leave it out: expected 'effects' with 'environment'"
        )
    return replace(scene, environment=read(path, where))


def read(path: Path, where: str) -> Array:
    """Linear radiance [H, W, 3] of a latitude-longitude picture, as :mod:`.environment` has it.

    Raises:
        InputError: no such picture, a kind with values from 0 to 1 alone, or values that are no
            radiance.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{where}: expected a picture in {', '.join(SUFFIXES)}, got '{path.name}'")
    if not path.is_file():
        raise InputError(f"{where}: no such file: {path}")
    import mitsuba as mi

    try:
        picture = mi.Bitmap(str(path))
        if picture.pixel_format() == mi.Bitmap.PixelFormat.MultiChannel:
            raise InputError(f"{where}: {path} has several layers; expected one picture in colour")
        picture = picture.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{where}: {path} cannot be read: {reason}") from None
    values = np.array(picture)
    if not np.isfinite(values).all() or (values < 0).any():
        raise InputError(f"{where}: {path} holds values that are no radiance (below 0 or nan)")
    if min(values.shape[:2]) < 2:
        raise InputError(f"{where}: {path} is too small: {values.shape[1]} x {values.shape[0]}")
    return values
