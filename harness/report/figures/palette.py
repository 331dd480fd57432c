"""One colour, marker and dash per method, the same in every figure.

Okabe and Ito's and Paul Tol's colours, which keep apart under the common colour-vision
deficiencies. Colour is never alone: marker and dash differ too. The floor and the ceiling are
grey and black. :func:`told_apart` says what is left where there is no colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from harness.analysis.results import MethodColumn, Results

_DASHED, _DOTTED, _DASH_DOT = (0, (5, 2)), (0, (1, 1.5)), (0, (6, 1.5, 1, 1.5))
_LONG = (0, (10, 2))


@dataclass(frozen=True)
class Look:
    """How a method is drawn."""

    colour: str
    marker: str
    dash: Any = "-"

    @property
    def ink(self) -> str:
        """The colour for words: darker where it is too light to read on white."""
        share = min(1.0, (_WORDS / max(luminance(self.colour), 1e-9)) ** (1 / 2.2))
        return "#" + "".join(f"{round(share * c):02x}" for c in _bytes(self.colour))


_WORDS = 0.16
"""The most luminance of words on white: a contrast of five to one."""


def luminance(colour: str) -> float:
    """Relative luminance of ``#rrggbb``, 0 to 1 (sRGB, Rec. 709): what is left in grey."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (byte / 255 for byte in _bytes(colour))
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _bytes(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


_KNOWN = {
    "cosine": Look("#8c8c8c", "o", _DOTTED),
    "blinn-phong": Look("#E69F00", "v"),
    "fan-baseline": Look("#56B4E9", "h", _DASH_DOT),
    "improved-baseline": Look("#0072B2", "s"),
    "two-lobe": Look("#009E73", "^"),
    "realnvp": Look("#CC79A7", "<", _DASHED),
    "neural-spline-flow": Look("#D55E00", "D"),
    "histogram": Look("#999933", ">", _DASHED),
    "histogram-mixture": Look("#5B2A9D", "P"),
    "importance-baked": Look("#882255", "X"),
    "reparameterised": Look("#7A4B1E", "d", _DASHED),
    "flow-matching": Look("#DDAA33", "8", _DASHED),
    "puresample": Look("#332288", "H", _DOTTED),
    "native": Look("#44AA99", "p", _DASHED),
    "tabulated": Look("#000000", "*", _DASHED),
}
_SPARE = (
    Look("#117733", "v", _DOTTED),
    Look("#AA4466", "s", _DASH_DOT),
    Look("#88CCEE", "^", _DASHED),
    Look("#661100", "D", _DOTTED),
    Look("#4477AA", "<", _LONG),
    Look("#BB5566", "P", _LONG),
    Look("#997700", "X", _LONG),
    Look("#004488", ">", _LONG),
    Look("#EE99AA", "d", _LONG),
    Look("#6699CC", "*", _LONG),
)


_ALIKE = ("ohH8p", "Dd")
"""Markers whose small pictures look alike."""
_CONTRAST = 1.3
"""Ratio of luminances from which two greys differ."""


def told_apart(one: Look, other: Look) -> bool:
    """Whether two looks differ in print without colour: by marker, dash or grey."""
    kinds = [next((k for k in _ALIKE if look.marker in k), look.marker) for look in (one, other)]
    dark, light = sorted(luminance(look.colour) + 0.05 for look in (one, other))
    return kinds[0] != kinds[1] or one.dash != other.dash or light / dark >= _CONTRAST


def looks(results: Results) -> dict[str, Look]:
    """Label -> look, of all methods."""
    return looks_of(results.methods)


def looks_of(methods: list[MethodColumn]) -> dict[str, Look]:
    """Label -> look. Known names have their own; variants and newcomers take spare ones."""
    chosen: dict[str, Look] = {}
    taken: set[str] = set()
    # A label that is the registry name comes first, so that a variant cannot take its look.
    for method in sorted(methods, key=lambda m: m.label != m.name):
        if method.name in _KNOWN and method.name not in taken:
            chosen[method.label] = _KNOWN[method.name]
            taken.add(method.name)
    spare = 0
    for method in methods:
        if method.label not in chosen:
            chosen[method.label] = _SPARE[spare % len(_SPARE)]
            spare += 1
    return chosen
