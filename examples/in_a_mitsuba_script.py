"""Fitted samplers as BSDFs of one's own Mitsuba scene: writes in_a_mitsuba_script.png."""

from __future__ import annotations

import mitsuba as mi

mi.set_variant("llvm_ad_rgb")

import harness  # noqa: E402
from harness import Budget  # noqa: E402

copper = {"type": "roughconductor", "material": "Cu", "alpha": 0.2}
budget = Budget(steps=50, conditions=64, directions=32, resolution=32, pool=128)
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {
            "type": "perspective",
            "fov": 35,
            "to_world": mi.ScalarTransform4f().look_at([0, -6, 2], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 48, "height": 32},
        },
        "sky": {"type": "constant"},
        "lamp": {"type": "point", "position": [3, -4, 4], "intensity": 20.0},
        "left": {
            "type": "sphere",
            "center": [-1.1, 0, 0],
            "bsdf": harness.fit("improved-baseline", copper, budget).bsdf(),
        },
        "right": {
            "type": "sphere",
            "center": [1.1, 0, 0],
            "bsdf": harness.fit("histogram", "leather", budget).bsdf(),
        },
    }
)
with harness.evaluated_mode():  # faster; what has a part in PyTorch needs it
    image = mi.render(scene, spp=16)
mi.util.write_bitmap("in_a_mitsuba_script.png", image)
print("mean of the picture:", float(image.array.numpy().mean()))
