"""What a Mitsuba BSDF reads of a point, apart from (u, v): found by changing one thing at a time.

A condition of the harness says where on the material a row is and what is seen there, not where
in a scene: a method is fitted before there is one. What a BSDF reads beyond that has either to
be carried by the condition, as the derivatives of the position are, or to be refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROWS = 512
"""Points and pairs of directions, the same for each thing that is changed."""
APART = 0.05
"""Relative change of a value that rounding does not make, not even in a narrow lobe."""
SHARE = 0.01
"""Of rows that have to change so."""

DERIVATIVES = "derivatives"
REASONS = {
    "position": "reads the position of the point in space",
    "primitive": "reads which triangle the point is on",
    "orientation": "depends on how the surface lies in space, and not on directions relative to"
    " it alone (in Mitsuba, a bump map around an anisotropic lobe does)",
    "geometric normal": "reads the geometric normal beside the shading normal",
    "differentials": "reads ray differentials (the footprint of a pixel)",
    "time": "reads the time",
}
"""What else may be read, and why a material that reads it is refused."""
_BEHIND = "behind"
_VARIANTS = ("", DERIVATIVES, *REASONS, _BEHIND)

Fields = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Seen:
    """``reads``: :data:`DERIVATIVES` and keys of :data:`REASONS`; ``both_sides``: whether it
    reflects from behind as it does from the front."""

    reads: frozenset[str]
    both_sides: bool


def look(mi: Any, bsdf: Any) -> Seen:
    """What ``bsdf`` does at random points, on the front.

    What shows in less than a hundredth of them may be missed; a renderer compares once more at
    true hits of its scene.
    """
    rng = np.random.default_rng(20)
    points = _points(mi, bsdf)
    parts = [_changed(points, name, rng) for name in _VARIANTS]
    fields = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    si, wo = _interaction(mi, fields), _vector(mi.Vector3f, mi, fields["wo"])
    rgb = np.array(bsdf.eval(mi.BSDFContext(), si, wo), np.float64)
    value = np.abs(rgb).max(0).reshape(len(_VARIANTS), ROWS)
    plain, behind = value[0], value[-1]
    apart = np.abs(value - plain) > APART * np.maximum(value, plain)
    return Seen(
        frozenset(name for k, name in enumerate(_VARIANTS[1:-1], 1) if apart[k].mean() > SHARE),
        bool((behind > 0).any() and apart[-1].mean() <= SHARE),
    )


def _points(mi: Any, bsdf: Any) -> Fields:
    """Random points on a plane; half of the directions drawn by the BSDF, for narrow lobes."""
    rng = np.random.default_rng(21)
    fields = {
        "wi": _hemisphere(rng),
        "wo": _hemisphere(rng),
        "uv": rng.random((ROWS, 2)),
        "p": rng.random((ROWS, 3)),
        "prim_index": np.zeros((ROWS, 1)),
        "time": np.zeros((ROWS, 1)),
        **{key: np.zeros((ROWS, 2)) for key in ("duv_dx", "duv_dy")},
    }
    for axis, keys in enumerate((("s", "dp_du"), ("t", "dp_dv"), ("n", "sh_n"))):
        fields |= {key: np.tile(np.eye(3)[axis], (ROWS, 1)) for key in keys}
    u = rng.random((ROWS, 3))
    drawn, _ = bsdf.sample(
        mi.BSDFContext(), _interaction(mi, fields),
        mi.Float(_column(u[:, 0])), _vector(mi.Point2f, mi, u[:, 1:]),
    )  # fmt: skip
    wo = np.array(drawn.wo).T
    use = (np.arange(ROWS) % 2 == 0) & (wo[:, 2] > 0)
    return fields | {"wo": np.where(use[:, None], wo, fields["wo"])}


def _changed(fields: Fields, name: str, rng: np.random.Generator) -> Fields:
    """The points with the one thing changed that ``name`` says."""
    if name == DERIVATIVES:
        # In the plane of the surface: no other part of them changes a slope.
        du, dv = np.zeros((2, ROWS, 3))
        du[:, 0], dv[:, 1] = np.exp(rng.uniform(-1.5, 1.5, (2, ROWS)))
        dv[:, 0] = rng.uniform(-0.5, 0.5, ROWS)
        return fields | {"dp_du": du, "dp_dv": dv}
    if name == "position":
        # Near and far: a volume may be a unit cube or a landscape.
        reach = np.repeat([1.0, 3.0, 30.0, 1000.0], ROWS // 4)[:, None]
        return fields | {"p": rng.uniform(-1, 1, (ROWS, 3)) * reach}
    if name == "primitive":
        return fields | {"prim_index": rng.integers(1, 1000, (ROWS, 1))}
    if name == "orientation":
        turn = np.linalg.qr(rng.normal(size=(ROWS, 3, 3)))[0]
        turn[:, :, 2] *= np.linalg.det(turn)[:, None]
        s, t, n = turn.transpose(2, 0, 1)
        return fields | {"s": s, "t": t, "sh_n": n, "n": n, "dp_du": s, "dp_dv": t}
    if name == "geometric normal":
        # A little: a bump map only asks on which side of the surface its normal lies.
        tilt = np.concatenate([rng.uniform(-0.08, 0.08, (ROWS, 2)), np.ones((ROWS, 1))], 1)
        return fields | {"n": tilt / np.linalg.norm(tilt, axis=1, keepdims=True)}
    if name == "differentials":
        return fields | {key: rng.uniform(-0.3, 0.3, (ROWS, 2)) for key in ("duv_dx", "duv_dy")}
    if name == "time":
        return fields | {"time": rng.uniform(0, 10, (ROWS, 1))}
    if name == _BEHIND:
        return fields | {key: fields[key] * (1, 1, -1) for key in ("wi", "wo")}
    return fields


def _interaction(mi: Any, fields: Fields) -> Any:
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(fields["wi"]))
    for key in ("wi", "dp_du", "dp_dv"):
        setattr(si, key, _vector(mi.Vector3f, mi, fields[key]))
    si.p, si.n = _vector(mi.Point3f, mi, fields["p"]), _vector(mi.Normal3f, mi, fields["n"])
    si.uv = _vector(mi.Point2f, mi, fields["uv"])
    si.duv_dx = _vector(mi.Vector2f, mi, fields["duv_dx"])
    si.duv_dy = _vector(mi.Vector2f, mi, fields["duv_dy"])
    axes = [_vector(mi.Vector3f, mi, fields[key]) for key in ("s", "t", "sh_n")]
    si.sh_frame = mi.Frame3f(*axes)
    si.time = mi.Float(_column(fields["time"][:, 0]))
    si.prim_index = mi.UInt32(fields["prim_index"][:, 0].astype(np.uint32))
    return si


def _vector(kind: Any, mi: Any, rows: NDArray) -> Any:
    return kind(*(mi.Float(_column(rows[:, i])) for i in range(rows.shape[1])))


def _column(values: NDArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)


def _hemisphere(rng: np.random.Generator) -> NDArray:
    """Directions, uniform on the projected disk."""
    radius, angle = 0.999 * np.sqrt(rng.random(ROWS)), 2 * np.pi * rng.random(ROWS)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return np.stack([x, y, np.sqrt(1 - x * x - y * y)], 1)
