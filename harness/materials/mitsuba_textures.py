"""What varies over a Mitsuba BSDF: its textures, and the features that a fitted method sees."""

from __future__ import annotations

import copy
import functools
import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

POINTS = 1 << 16
"""Random places at which textures are compared. No grid: whatever repeats a whole number of
times over a grid looks the same at all of its points."""

Source = Callable[[Any], Sequence[Any]]
"""Several columns of numbers at surface interactions, such as a texture's colour."""


def below(mi: Any, bsdf: Any) -> list[tuple[str, Any]]:
    """Every BSDF and texture in ``bsdf``, itself first, by path, in a fixed order."""
    found, queue = [], [("", bsdf)]

    class Children(mi.TraversalCallback):
        def __init__(self, path: str):
            super().__init__()
            self.path = path

        def put_object(self, name: str, child: Any, *_: Any) -> None:
            queue.append((f"{self.path}.{name}", child))

        def put(self, name: str, child: Any, *_: Any) -> None:
            if isinstance(child, mi.Object):
                self.put_object(name, child)

        def put_value(self, *_: Any) -> None:
            pass

    while queue:
        path, node = queue.pop(0)
        if node is None:
            continue
        found.append((path, node))
        if not isinstance(node, mi.Texture):
            node.traverse(Children(path))
    return sorted(found, key=lambda item: item[0])


def varying(mi: Any, bsdf: Any) -> list[tuple[str, Any]]:
    """Every spatially varying texture below ``bsdf``, by path, in a fixed order."""
    return [
        (path, node)
        for path, node in below(mi, bsdf)
        if isinstance(node, mi.Texture) and node.is_spatially_varying()
    ]


def bumps(mi: Any, bsdf: Any) -> list[tuple[Any, float, str]]:
    """``(height texture, its factor, its path)`` of every bump map below ``bsdf``."""
    nodes = below(mi, bsdf)
    textures = dict(nodes)
    return [
        (textures[f"{path}.nested_texture"], float(mi.traverse(node)["scale"]),
         f"{path}.nested_texture")
        for path, node in nodes
        if isinstance(node, mi.BSDF) and node.class_name() == "BumpMap"
        and f"{path}.nested_texture" in textures
    ]  # fmt: skip


class Features:
    """The columns that say what is at a place: all that vary and repeat no earlier one.

    Channels of textures; with ``tilts``, of bump maps the tilted normal (x, y) instead of the
    height, which says nothing of the slope.
    """

    def __init__(self, mi: Any, bsdf: Any, tilts: bool):
        self._tilts = tilts
        self._sources = self._of(mi, bsdf)
        self._channels = _distinct(mi, self._sources)

    def __len__(self) -> int:
        return sum(len(channels) for channels in self._channels)

    def __call__(self, si: Any) -> list[Any]:
        """One array for each feature, at surface interactions."""
        found = []
        for (source, _), channels in zip(self._sources, self._channels, strict=True):
            values = source(si) if channels else ()
            found += [values[channel] for channel in channels]
        return found

    def rebound(self, mi: Any, bsdf: Any) -> Features:
        """The same columns of a BSDF that has the same textures with other texels."""
        other = copy.copy(self)
        other._sources = self._of(mi, bsdf)
        return other

    def _of(self, mi: Any, bsdf: Any) -> list[tuple[Source, list[str | None]]]:
        mapped = bumps(mi, bsdf) if self._tilts else []
        heights = {path for _, _, path in mapped}
        textures = [t for path, t in varying(mi, bsdf) if path not in heights]
        found: list[tuple[Source, list[str | None]]] = [(t.eval, _known(mi, t)) for t in textures]
        for texture, factor, _ in mapped:
            found.append((functools.partial(_tilted_normal, mi, texture, factor), [None] * 2))
        return found


def _tilted_normal(mi: Any, texture: Any, factor: float, si: Any) -> Any:
    """The bumped normal: of dp_du + n g_u and dp_dv + n g_v in the plane, g the gradient."""
    slope = factor * texture.eval_1_grad(si)
    du, dv = si.to_local(si.dp_du), si.to_local(si.dp_dv)
    normal = dr.normalize(
        dr.cross(mi.Vector3f(du.x, du.y, slope.x), mi.Vector3f(dv.x, dv.y, slope.y))
    )
    # On the side of the surface, whichever way u and v turn.
    return normal * dr.sign(normal.z)


def _known(mi: Any, texture: Any) -> list[str | None]:
    """For each channel what its texels are, "" if they are all the same.

    None where there are no texels. A mark that is too small for any random point is in the
    texels yet, and what rounding makes of equal texels is not.
    """
    values = mi.traverse(texture)
    texels = np.array(values["data"]) if "data" in values else np.empty(0)
    if texels.ndim != 3 or texels.shape[-1] not in (1, 3):
        return [None] * 3
    # Where and how they are looked up is part of it.
    how = hashlib.sha256(str(texture).encode()).hexdigest()
    return [
        how + hashlib.sha256(np.ascontiguousarray(c)).hexdigest() if np.ptp(c) > 0 else ""
        for c in np.moveaxis(texels, -1, 0)
    ]


def _distinct(mi: Any, sources: list[tuple[Source, list[str | None]]]) -> list[list[int]]:
    """The channels of each source that vary, each once."""
    si = dr.zeros(mi.SurfaceInteraction3f, POINTS)
    # A fixed seed: the same texture has the same features.
    u, v = np.random.default_rng(1).random((2, POINTS), np.float32)
    si.uv = mi.Point2f(mi.Float(u), mi.Float(v))
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    values = [source(si) for source, _ in sources]
    dr.eval(values)
    kept: list[list[int]] = []
    seen: list[np.ndarray] = []
    texels = {""}
    for (_, known), value in zip(sources, values, strict=True):
        channels = []
        for channel, data in enumerate(known):
            if data is not None:
                channels += [] if data in texels else [channel]
                texels.add(data)
                continue
            array = np.broadcast_to(np.array(value[channel]), POINTS)
            if np.ptp(array) > 0 and not any(np.array_equal(array, other) for other in seen):
                channels.append(channel)
                seen.append(array)
        kept.append(channels)
    return kept
