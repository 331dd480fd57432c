"""Descriptions of surfaces for walks, in YAML.

::

    name: bronze-grains
    about: one line
    primitives:
      shape: sphere            # sphere, ellipsoid or pyramid
      arrangement: poisson     # poisson, grid or staggered
      per_side: 12             # 144 in the tile
      size: 0.38               # half axes, in spacings (1 / per_side): a number or three
      seed: 1
    micro: {bsdf: rough-conductor, reflectance: "#d8a060"}
    ground: lambertian         # the same as micro, if not given
    fields: {patch: "step(noise(3, seed=2), 0, 0.2)"}
    colour:                    # layers as those of a relief, looked up at each primitive's centre
      - {by: patch, ramp: [[0, "#803020"], [1, "#e0c080"]]}

or, instead of ``primitives``, ``facets: {alpha: 0.3, seed: 1}``, a field of Beckmann's slopes.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field as PydanticField
from pydantic import ValidationError, model_validator

from harness.core.protocol.errors import InputError
from harness.core.refusal import refusal
from harness.core.schema import Strict, Word
from harness.microgeometry.description import Code, Description, Layer, Text
from harness.microgeometry.tile import Tile
from harness.microgeometry.walks import beckmann, placing
from harness.microgeometry.walks.kernel import BOUND
from harness.microgeometry.walks.micro import MicroBSDF
from harness.microgeometry.walks.primitives import Primitives, turned
from harness.microgeometry.walks.surface import WalkedSurface
from harness.textures import maps

Positive = Annotated[float, PydanticField(gt=0, le=10)]
_COLOURS = 256
"""Texels a side of the grid on which colours are looked up."""


class PrimitivesOf(Strict):
    """``size`` are half axes in spacings: of a sphere one, of an ellipsoid three (the third is
    upright), of a pyramid the half base and the height. ``sunk`` is the share of a primitive's
    lower half that lies in the ground; ``direction``, in degrees, turns the first axis about the
    normal, ``scatter`` is the deviation of that turn and of a tilt. ``overlap`` is how far into
    each other neighbours may reach, as a share of their size."""

    shape: Literal["sphere", "ellipsoid", "pyramid"]
    arrangement: Literal["poisson", "grid", "staggered"] = "poisson"
    per_side: Annotated[int, PydanticField(ge=1, le=64)]
    size: Positive | Annotated[list[Positive], PydanticField(min_length=2, max_length=3)]
    sunk: Annotated[float, PydanticField(ge=0, lt=1)] = 0.0
    direction: float = 0.0
    scatter: Annotated[float, PydanticField(ge=0, le=45)] = 0.0
    overlap: Annotated[float, PydanticField(ge=0, le=0.5)] = 0.0
    seed: int = 0

    @property
    def half_axes(self) -> tuple[float, float, float]:
        """Along x, y and z before any turn, in widths of the tile."""
        given = self.size if isinstance(self.size, list) else [self.size]
        wanted = {"sphere": 1, "ellipsoid": 3, "pyramid": 2}[self.shape]
        if len(given) != wanted:
            raise InputError(
                f"primitives.size: expected {wanted} numbers for '{self.shape}', got {len(given)}"
            )
        full = {1: given * 3, 2: [given[0], *given], 3: given}[wanted]
        return tuple(value / self.per_side for value in full)


class Facets(Strict):
    """``alpha`` is Beckmann's roughness, or two along x and y; ``correlation`` in texels."""

    alpha: Positive | Annotated[list[Positive], PydanticField(min_length=2, max_length=2)]
    resolution: Annotated[int, PydanticField(ge=64, le=2048, multiple_of=4)] = 512
    correlation: Annotated[float, PydanticField(ge=1, le=64)] = 4.0
    seed: int = 0


class Micro(Strict):
    """``bsdf`` is a word or a Mitsuba BSDF; ``reflectance`` (an sRGB code) multiplies it."""

    bsdf: str | dict[str, Any]
    reflectance: Code = "#ffffff"


class WalkDescription(Strict):
    """A whole description; see the module for an example."""

    name: Word
    about: str
    primitives: PrimitivesOf | None = None
    facets: Facets | None = None
    micro: str | Micro
    ground: str | Micro | None = None
    fields: dict[str, Text] = {}
    colour: Annotated[list[Layer], PydanticField(min_length=1)] | None = None
    bound: Annotated[int, PydanticField(ge=1, le=100_000)] = BOUND

    @model_validator(mode="after")
    def _one_shape(self) -> WalkDescription:
        if (self.primitives is None) == (self.facets is None):
            raise ValueError("expected either 'primitives' or 'facets'")
        if self.facets is not None and (self.colour or self.ground is not None):
            raise ValueError("'colour' and 'ground' go with 'primitives', not with 'facets'")
        return self

    def surface(self) -> WalkedSurface:
        """The surface; :class:`InputError` says what cannot be."""
        micro = _micro(self.micro, "micro")
        ground = micro if self.ground is None else _micro(self.ground, "ground")
        source = {"description": self.model_dump(exclude={"name", "about"})}
        shape = self._facets() if self.facets is not None else self._primitives()
        return WalkedSurface(
            self.name, self.about, shape, micro, ground, bound=self.bound, source=source
        )

    def _facets(self) -> Tile:
        f = self.facets
        assert f is not None
        alpha = f.alpha if isinstance(f.alpha, list) else [f.alpha, f.alpha]
        height = beckmann.heights(alpha[0], alpha[1], f.resolution, f.correlation, f.seed)
        # Flat triangles: the facets are the model, and interpolated normals lose energy.
        return Tile(self.name, height, {}, smooth=False)

    def _primitives(self) -> Primitives:
        p = self.primitives
        assert p is not None
        half, random = np.array(p.half_axes), np.random.default_rng(p.seed)
        turn = math.radians(p.direction)
        centre = self._centres(half, turn, random)
        n = len(centre)
        scatter = math.radians(p.scatter)
        direction = turn + scatter * random.standard_normal(n)
        # A pyramid stands upright, or there would be a gap below it.
        tilt = scatter * random.standard_normal(n) * (p.shape != "pyramid")
        axes = turned(direction, tilt) * half
        pyramid = p.shape == "pyramid"
        upright = Primitives("pyramid" if pyramid else "sphere", np.zeros((n, 3)), axes,
                             np.ones((n, 3))).half_extent[:, 2]  # fmt: skip
        z = -p.sunk * half[2] * np.ones(n) if pyramid else upright * (1 - 2 * p.sunk)
        found = Primitives(
            "pyramid" if pyramid else "sphere",
            np.concatenate([centre, z[:, None]], 1),
            axes,
            self._tints(centre),
        )
        try:
            found.check()
        except InputError as error:
            raise InputError(f"primitives.{error}") from None
        return found

    def _centres(self, half: np.ndarray, turn: float, random: np.random.Generator) -> np.ndarray:
        p = self.primitives
        assert p is not None
        rotation = turned(np.array([turn]), np.zeros(1))[0, :2, :2]
        # By this metric two footprints touch at a distance of one. Pyramids: their corners' circle
        # would keep neighbours of a closed grid apart, so the square's inscribed circle counts.
        metric = np.diag(1 / (2 * half[:2] * (1 - p.overlap))) @ rotation.T
        try:
            if p.arrangement == "poisson":
                return placing.poisson(p.per_side**2, metric, random)
            make = placing.grid if p.arrangement == "grid" else placing.staggered
            centre = make(p.per_side)
        except InputError as error:
            raise InputError(f"primitives: {error}") from None
        least = placing.closest(centre, metric) * (1 - p.overlap)
        if least < 1 - p.overlap - 1e-9:
            raise InputError(
                f"primitives: neighbours reach into each other by {1 - least:.0%} of their size;"
                f" expected at most the 'overlap' of {p.overlap:.0%}"
            )
        return centre

    def _tints(self, centre: np.ndarray) -> np.ndarray:
        if self.colour is None:
            return np.ones((len(centre), 3))
        described = Description(
            name=self.name, about=self.about, fields=self.fields, colour=self.colour
        )
        described.check()
        colours = described.surface(_COLOURS).bsdf["base_color"]["array"]
        at = (centre * _COLOURS).astype(int) % _COLOURS
        return np.asarray(colours, float)[at[:, 1], at[:, 0]]


def _micro(given: str | Micro, where: str) -> MicroBSDF:
    if isinstance(given, str):
        return MicroBSDF.of(given, where)
    reflectance = tuple(float(value) for value in maps.colour(given.reflectance))
    return MicroBSDF.of({"bsdf": given.bsdf, "reflectance": reflectance}, where)


def is_walked(data: Any) -> bool:
    """Whether data as YAML gives it describes a surface for walks, and not a relief."""
    return isinstance(data, dict) and bool({"primitives", "facets"} & set(data))


def parse(data: Any) -> WalkedSurface:
    """The surface of data as YAML gives it; :class:`InputError` if refused."""
    try:
        description = WalkDescription.model_validate(data)
    except ValidationError as error:
        raise InputError(refusal(WalkDescription, error).replace("Value error, ", "")) from None
    return description.surface()


def read(path: Path) -> WalkedSurface:
    """The surface of a file; :class:`InputError` names the file, key and nearest name."""
    from harness.core.yamlfile import read_yaml

    data = read_yaml(path, "a description in YAML")
    try:
        return parse(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
