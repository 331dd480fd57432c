"""Descriptions of microgeometry in YAML: what they may say, and the surface they make.

::

    name: leather
    about: one line
    relief: {field: height, depth: 0.02}      # displacement, tile widths per unit of the field
    fields:                                   # expressions, each may use those before it
      grain: step(cells(34, seed=1).border, 0, 0.2)
      height: blur(grain, 0.003)
    colour:                                   # layers, from the bottom
      - {by: grain, ramp: [[0, "#2a0f06"], [1, "#d08a4a"]]}
      - {colour: "#f6efe0", where: 0.5 * grain}
      - {shade: 0.7 + 0.3 * grain}
    roughness: 0.3 + 0.1 * grain              # and the other parameters of `principled`
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field as PydanticField
from pydantic import StringConstraints, ValidationError, model_validator

from harness.core.protocol.errors import InputError
from harness.core.refusal import refusal
from harness.core.schema import Strict, Word
from harness.identity.digests import Part
from harness.identity.ours import digest_of
from harness.microgeometry.expressions import Expression
from harness.microgeometry.surface import Surface
from harness.textures import maps

Text = str | float | int
Code = Annotated[str, StringConstraints(pattern=r"^#[0-9a-fA-F]{6}$")]

_TRACED = Part(
    ("harness.microgeometry.description:Description", "harness.microgeometry.surface:Surface"),
    ("surface", "reflectance", "heights", "energy"),
)
"""The code that the answers of a described surface come from."""
TEXTURED = (
    "roughness",
    "metallic",
    "anisotropic",
    "spec_tint",
    "sheen",
    "sheen_tint",
    "clearcoat",
    "clearcoat_gloss",
    "flatness",
)
"""Parameters of Mitsuba's ``principled`` that may vary over the tile, all in [0, 1]."""


class Relief(Strict):
    """``depth`` is the height, in widths of the tile, of one unit of ``field``."""

    field: Text
    depth: Annotated[float, PydanticField(ge=0)]


class Layer(Strict):
    """One layer of colour: a ramp or one colour, ``where`` it covers; or a ``shade``."""

    by: Text | None = None
    ramp: list[Annotated[list[Any], PydanticField(min_length=2, max_length=2)]] | None = None
    colour: Code | None = None
    where: Text = 1
    shade: Text | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Layer:
        kinds = [self.ramp is not None, self.colour is not None, self.shade is not None]
        if sum(kinds) != 1 or (self.ramp is None) != (self.by is None):
            raise ValueError("expected 'by' and 'ramp', or 'colour', or 'shade'")
        for stop in self.ramp or ():
            number = isinstance(stop[0], (int, float)) and not isinstance(stop[0], bool)
            if not number or not isinstance(stop[1], str) or not _is_code(stop[1]):
                raise ValueError('ramp: expected stops such as [0.5, "#8a5a3b"]')
        return self


class Description(Strict):
    """A whole description; see the module for an example and the manual for its words."""

    name: Word
    about: str
    resolution: Annotated[int, PydanticField(ge=16, le=4096, multiple_of=4)] = 512
    relief: Relief | None = None
    micro: Relief | None = None
    fields: dict[str, Text] = {}
    colour: Annotated[list[Layer], PydanticField(min_length=1)]
    specular: Annotated[float, PydanticField(ge=0, le=1)] = 0.5
    angle: Text | None = None
    roughness: Text = 0.5
    metallic: Text | None = None
    anisotropic: Text | None = None
    spec_tint: Text | None = None
    sheen: Text | None = None
    sheen_tint: Text | None = None
    clearcoat: Text | None = None
    clearcoat_gloss: Text | None = None
    flatness: Text | None = None

    def check(self) -> None:
        """Refuse expressions that mean nothing, without computing any."""
        known: list[str] = []
        for name, text in self.fields.items():
            if not name.isidentifier():
                raise InputError(f"fields: '{name}': expected a name of letters, digits and '_'")
            _parsed(f"fields.{name}", text, known)
            known.append(name)
        for where, text in self._uses():
            _parsed(where, text, known)

    def _uses(self) -> list[tuple[str, Text]]:
        """Every expression outside of ``fields``, with where it stands."""
        found = [(key, getattr(self, key)) for key in (*TEXTURED, "angle")]
        found += [
            (f"{key}.field", relief.field)
            for key, relief in (("relief", self.relief), ("micro", self.micro))
            if relief is not None
        ]
        for index, layer in enumerate(self.colour):
            found += [(f"colour[{index}].{k}", getattr(layer, k)) for k in ("by", "where", "shade")]
        return [(where, text) for where, text in found if text is not None]

    def surface(self, resolution: int | None = None) -> Surface:
        """The surface on a grid of ``resolution``^2 texels (or the description's own)."""
        size = self.resolution if resolution is None else resolution
        fields: dict[str, Any] = {}
        for name, text in self.fields.items():
            fields[name] = _evaluated(f"fields.{name}", text, size, fields)
        values = {where: _evaluated(where, text, size, fields) for where, text in self._uses()}
        bsdf: dict[str, Any] = {"type": "principled", "specular": self.specular}
        for key in TEXTURED:
            if getattr(self, key) is not None:
                bsdf[key] = _texture(key, values[key])
        bsdf["base_color"] = maps.bitmap(self._colours(size, values))
        full = (size, size)
        height = np.zeros(full)
        if self.relief is not None:
            height = height + self.relief.depth * values["relief.field"]
        micro = None
        if self.micro is not None:
            micro = maps.normals(np.broadcast_to(values["micro.field"], full), self.micro.depth)
        angle = None
        if self.angle is not None:
            angle = np.array(np.broadcast_to(values["angle"], full), float)
        source = {
            "description": self.model_dump(exclude={"name", "about"}),
            "resolution": size,
            "source": digest_of(_TRACED),
        }
        return Surface(self.name, height, bsdf, angle, micro, source=source)

    def _colours(self, size: int, values: Mapping[str, Any]) -> np.ndarray:
        result = np.zeros((size, size, 3))
        for index, layer in enumerate(self.colour):
            where = f"colour[{index}]"
            if layer.shade is not None:
                shade = np.broadcast_to(values[f"{where}.shade"], (size, size))
                result = result * _unit(f"{where}.shade", shade)[..., None]
                continue
            cover = np.broadcast_to(values[f"{where}.where"], (size, size))
            if layer.ramp is not None:
                by = np.broadcast_to(values[f"{where}.by"], (size, size))
                top = maps.ramp(by, [(float(at), code) for at, code in layer.ramp])
            else:
                top = np.broadcast_to(maps.colour(str(layer.colour)), (size, size, 3))
            result = maps.mix(result, top, _unit(f"{where}.where", cover))
        return result


def parse(data: Any) -> Description:
    """A checked description from data as YAML gives it; :class:`InputError` if refused."""
    if not isinstance(data, dict):
        raise InputError("expected a mapping with the keys name, about, fields, colour, ...")
    _refuse_split_text(data, "")
    try:
        description = Description.model_validate(data)
    except ValidationError as error:
        raise InputError(refusal(Description, error).replace("Value error, ", "")) from None
    description.check()
    return description


def read(path: Path) -> Description:
    """The description in a file; :class:`InputError` names the file, key and nearest name."""
    from harness.core.yamlfile import read_yaml

    data = read_yaml(path, "a description in YAML")
    try:
        return parse(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _refuse_split_text(node: Any, where: str) -> None:
    """In ``{by: mix(0, 1, t)}`` YAML reads three entries; say so."""
    if isinstance(node, dict):
        for key, value in node.items():
            if not isinstance(key, str) or (value is None and ")" in key):
                raise InputError(
                    f"{where}: unexpected '{key}'; a comma ends an entry within {{ }},"
                    " so an expression with commas needs quotes there"
                )
            _refuse_split_text(value, f"{where}.{key}" if where else key)
    elif isinstance(node, list):
        for index, value in enumerate(node):
            _refuse_split_text(value, f"{where}[{index}]")


def _parsed(where: str, text: Text, known: list[str]) -> Expression:
    try:
        return Expression(text, known)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _evaluated(where: str, text: Text, size: int, fields: Mapping[str, Any]) -> Any:
    try:
        value = _parsed(where, text, list(fields))(size, fields)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if not np.isfinite(value).all():
        raise InputError(f"{where}: expected finite values: {text}")
    return value


def _texture(where: str, value: Any) -> Any:
    value = _unit(where, value)
    return float(value) if np.ndim(value) == 0 else maps.bitmap(value)


def _unit(where: str, value: Any) -> Any:
    low, high = float(np.min(value)), float(np.max(value))
    if low < -1e-6 or high > 1 + 1e-6:
        raise InputError(f"{where}: expected values from 0 to 1, got {low:.3g} to {high:.3g}")
    # Rounding of a blur, no more than that.
    return np.clip(value, 0, 1)


def _is_code(text: str) -> bool:
    return (
        len(text) == 7 and text[0] == "#" and all(c in "0123456789abcdefABCDEF" for c in text[1:])
    )
