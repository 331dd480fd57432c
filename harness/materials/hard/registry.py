"""Materials that are hard on purpose, by name: what a scene can hold at its worst.

Cheap to evaluate and without textures, except where the texture is the difficulty. The cases
that they stand for are in :mod:`harness.checks.catalogue`.
"""

from harness.materials.hard import flat, holes, lobes, specular
from harness.materials.hard.base import Made

MATERIALS: dict[str, Made] = {
    **specular.MATERIALS,
    **lobes.MATERIALS,
    **flat.MATERIALS,
    **holes.MATERIALS,
}
