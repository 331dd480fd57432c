"""What a scene of one effect costs beside the leanest Mitsuba set-up written by hand for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from harness.bench.adapters import Rows
from harness.scenes.base import AreaLamp, PointLamp, Scene
from harness.stats.intervals import ratio_of_medians

RESOLUTION, SPP = 128, 16
MATERIAL = {"type": "roughconductor", "alpha": 0.3}
_DIRECT = {"type": "direct", "bsdf_samples": 1, "emitter_samples": 0, "hide_emitters": True}
_MIS = _DIRECT | {"emitter_samples": 1}
_SKY = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
_LAMP = AreaLamp((0.0, 3.0, 3.0), (0.0, 0.0, 0.0), (2.0, 2.0), (8.0, 8.0, 8.0))
_POINT = PointLamp((0.0, 3.0, 3.0), (20.0, 20.0, 20.0))


@dataclass(frozen=True)
class Setup:
    """A scene's effects, and by hand: its emitters, its integrator and its kind of sensor."""

    effects: tuple[str, ...]
    lights: Callable[[Any], dict[str, Any]]
    integrator: dict[str, Any]
    sensor: str = "perspective"


def _area(mi: Any) -> dict[str, Any]:
    place = mi.ScalarTransform4f().look_at([0, 3, 3], [0, 0, 0], [0, 1, 0])
    return {
        "lamp": {
            "type": "rectangle",
            "to_world": place,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 8.0}},
        }
    }


def _point(mi: Any) -> dict[str, Any]:
    intensity = {"type": "rgb", "value": 20.0}
    return {"lamp": {"type": "point", "position": [0, 3, 3], "intensity": intensity}}


SETUPS = {
    "environment": Setup(("environment",), lambda mi: {"sky": _SKY}, _DIRECT),
    "area-lights": Setup(("area-lights",), _area, _DIRECT),
    "point-lights": Setup(("point-lights", "emitter-sampling"), _point, _MIS),
    "emitter-sampling": Setup(
        ("environment", "emitter-sampling"), lambda mi: {"sky": _SKY}, _MIS
    ),
    "indirect": Setup(
        ("environment", "emitter-sampling", "indirect: 4"),
        lambda mi: {"sky": _SKY},
        {"type": "path", "max_depth": 5, "hide_emitters": True},
    ),
    "depth-of-field": Setup(
        ("environment", "depth-of-field"), lambda mi: {"sky": _SKY}, _DIRECT, "thinlens"
    ),
}  # fmt: skip
"""By the effect that each is about; the first is all that a scene can do without the others."""


def run(device: str, rounds: int, notify: Callable[[str], None]) -> Rows:
    """Paired rounds of the harness's render and the one by hand, in the same process.

    Both show one sphere of one material of Mitsuba's, sampled by itself, with the same samples.
    The harness's also has the second moments that its errors are computed from.
    """
    cells = []
    for name, setup in SETUPS.items():
        notify(name)
        ours, theirs = _times(setup, device, rounds)
        ratio = ratio_of_medians(ours, theirs)
        cells.append(
            [
                name,
                f"{1e3 * np.median(ours) / SPP:.3g}",
                f"{1e3 * np.median(theirs) / SPP:.3g}",
                f"{ratio.value:.3f} [{ratio.low:.3f}, {ratio.high:.3f}]",
            ]
        )
    return Rows(
        title=f"Effects beside Mitsuba by hand, on {device}",
        caption=(
            f"medians of {rounds} paired rounds, {RESOLUTION} x {RESOLUTION} pixels at {SPP} spp;"
            " the ratio is of the same round, with its 95 % interval"
        ),
        columns=["effect", "ms/spp", "by hand", "ratio"],
        cells=cells,
    )


def _times(setup: Setup, device: str, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """Seconds [rounds] of the harness's render and of the one by hand."""
    from harness.mitsuba_runtime import variant

    mi = variant.use(device)
    import time

    import drjit as dr

    from harness.materials.mitsuba_bsdf import MitsubaMaterial
    from harness.rendering.prepared import prepare_native

    material = MitsubaMaterial("metal", dict(MATERIAL), {"type": "bench"})
    prepared = prepare_native(_scene(setup), material, RESOLUTION, None)
    by_hand, integrator = _by_hand(mi, setup, prepared)

    def ours(seed: int) -> float:
        return prepared.render(SPP, seed).seconds

    def theirs(seed: int) -> float:
        start = time.perf_counter()
        image = mi.render(by_hand, integrator=integrator, spp=SPP, seed=seed)
        np.array(image)  # as the harness's render, which hands its image out
        dr.sync_thread()
        return time.perf_counter() - start

    for seed in range(3):
        ours(seed), theirs(seed)
    times: list[tuple[float, float]] = []
    for number in range(rounds):
        # In turn first: what follows a render of the other kind may find a colder cache.
        if number % 2:
            b, a = theirs(100 + number), ours(100 + number)
        else:
            a, b = ours(100 + number), theirs(100 + number)
        times.append((a, b))
    a, b = np.array(times).T
    return a, b


def _scene(setup: Setup) -> Scene:
    from harness.scenes import registry as scenes

    ball = scenes.make("uniform-sphere")
    camera = replace(ball.camera, aperture=0.1, focus=4.0)
    return replace(ball, effects=setup.effects, lamps=(_LAMP, _POINT), camera=camera)


def _by_hand(mi: Any, setup: Setup, prepared: Any) -> tuple[Any, Any]:
    """The scene in Mitsuba's own words; the mesh is the very same, so that rays cost the same."""
    shape = next(s for s in prepared.scene.shapes() if s.bsdf() is prepared.bsdf)
    sensor = {
        "type": setup.sensor,
        "fov": 29.6,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": RESOLUTION,
            "height": RESOLUTION,
            "pixel_format": "rgb",
            "rfilter": {"type": "box"},
        },
    }
    if setup.sensor == "thinlens":
        sensor |= {"aperture_radius": 0.1, "focus_distance": 4.0}
    scene = {"type": "scene", "sensor": sensor, "ball": shape, **setup.lights(mi)}
    return mi.load_dict(scene), mi.load_dict(dict(setup.integrator))
