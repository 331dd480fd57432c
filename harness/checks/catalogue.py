"""The hard cases by name: what a renderer meets on its worst day, and what is checked then."""

from __future__ import annotations

from dataclasses import dataclass

from harness.checks import hard_conditions as at
from harness.checks import hard_states as states
from harness.checks.hard_conditions import Conditions
from harness.checks.hard_states import Alter

BASE = "suede"
"""Material of the cases that are about directions, states and inputs."""

DIRECTION, LOBE, DATA, STATE, INPUT = GROUPS = ("direction", "lobe", "data", "state", "input")


@dataclass(frozen=True)
class HardCase:
    """One case.

    ``conditions(material, generator, device)`` gives the rows [K, C], K <= 2, that are tested.
    ``alter(method, generator)`` gives a state to load in place of the fitted one, or None
    where the method has no such state. ``inputs`` names the property that *is* the case; the
    ``checks`` are those of any other case. ``material`` is a name for ``materials.registry``.
    """

    name: str
    group: str
    about: str
    material: str = BASE
    conditions: Conditions = at.normal_and_oblique
    alter: Alter | None = None
    inputs: str = ""
    checks: tuple[str, ...] = (
        "pdf-finite",
        "coverage",
        "integral",
        "samples-pdf",
        "sample-pdf",
        "tail",
        "weights",
    )


def _direction(name: str, about: str, conditions: Conditions) -> HardCase:
    return HardCase(name, DIRECTION, about, conditions=conditions)


def _material(
    name: str, group: str, about: str, conditions: Conditions = at.normal_and_oblique
) -> HardCase:
    return HardCase(name, group, about, name, conditions)


def _state(name: str, about: str, alter: Alter) -> HardCase:
    return HardCase(name, STATE, about, alter=alter)


def _input(name: str, about: str, inputs: str) -> HardCase:
    return HardCase(name, INPUT, about, inputs=inputs)


_CASES = (
    _direction(
        "normal",
        "wi = 0, which has no azimuth: a surface seen straight on",
        at.normal,
    ),
    *(
        _direction(
            f"grazing-1e-{k}",
            f"cos 1e-{k} between wi and the normal: the silhouette of a curved surface",
            at.grazing(10.0**-k),
        )
        for k in range(2, 7)
    ),
    _direction(
        "horizontal",
        "wi exactly in the surface: a silhouette, rounded",
        at.horizontal,
    ),
    _material("specular-1e-1", LOBE, "GGX of roughness 0.1: satin metal"),
    _material("specular-1e-2", LOBE, "GGX of roughness 0.01: polished metal"),
    _material("specular-1e-3", LOBE, "GGX of roughness 0.001: chrome"),
    _material(
        "specular-1e-4", LOBE, "GGX of roughness 0.0001: a mirror in a rough material's place"
    ),
    _material("anisotropic-100", LOBE, "GGX of roughness 0.5 by 0.005: brushed metal, vinyl"),
    _material(
        "below-horizon", LOBE, "a lobe mostly below the horizon: a bent normal seen from the side"
    ),
    _material("rim-lobe", LOBE, "a narrow lobe on the disk's rim: a wet road against the sun"),
    _material("distant-lobes", LOBE, "five narrow lobes far apart, one of 1 %: sequins, cut glass"),
    _material("constant", LOBE, "f constant: chalk, where a lobe has nothing to fit"),
    *(
        HardCase(
            f"polished-{family}",
            LOBE,
            f"{family} at its least roughness, seen at cos 0.1 and 0.01: a polished edge",
            family,
            at.polished,
        )
        for family in ("disney", "ggx-conductor", "layered")
    ),
    _material(
        "black-texels",
        DATA,
        "half of the texels exactly black: soot, a decal; 0/0 waits in each",
        at.black_and_lit,
    ),
    _material(
        "black-hemisphere", DATA, "f exactly 0 for half of the directions: slats, lenticulars"
    ),
    _material("bright-pixel", DATA, "92 % of the energy in a millionth of the disk: a firefly"),
    _material("measured-holes", DATA, "sectors below zero and without data: a measurement"),
    _material("blue-only", DATA, "energy in one colour channel alone: saturated pigment"),
    HardCase(
        "far-features",
        DATA,
        "features 1e3 and 1e6 deviations from those fitted: a texture in another unit",
        conditions=at.far_features,
    ),
    _state("untrained", "networks as initialised: a fit that was forgotten", states.untrained),
    _state(
        "badly-trained",
        "noise three times the spread of every weight: a fit that diverged",
        states.badly_trained,
    ),
    _state(
        "large-outputs",
        "last biases at +-50: a step size that was too large",
        states.large_outputs,
    ),
    _state(
        "sigma-to-0",
        "lobes as narrow as the parameters allow: a fit to a mirror",
        states.extreme("sigma-to-0", "exponent-to-infinity", "scale-to-0"),
    ),
    _state(
        "sigma-to-infinity",
        "lobes as wide as the parameters allow: a fit to noise",
        states.extreme("sigma-to-infinity", "exponent-to-0", "scale-to-infinity"),
    ),
    _state(
        "weights-to-0",
        "least weight on every lobe but the diffuse one: a fit to a diffuse material",
        states.extreme("weights-to-0"),
    ),
    _state(
        "uniform-to-0",
        "least weight on all but the first lobe: a fit that forgot the diffuse part",
        states.extreme("uniform-to-0"),
    ),
    _state(
        "bfloat16-weights",
        "every weight rounded to bfloat16: inference at half the memory",
        states.bfloat16_weights,
    ),
    _input("u-corners", "uniforms of exactly 0 and of the largest float below 1", "u-corners"),
    _input("bin-edges", "directions on edges of bins, axes, the dyadic grid", "bin-edges"),
    _input(
        "outside-disk", "directions off the disk: pdf asked of an invalid sample", "outside-disk"
    ),
    _input("nan-inputs", "nan or infinity in one row: a degenerate triangle", "nan-confined"),
    _input("half-million-rows", "2^19 + 1 rows in one call: a whole image", "batch-half-million"),
    _input("double-precision", "pdf in single precision against double", "float64"),
    _input("bfloat16-inputs", "inputs as bfloat16: a network's features handed on", "bfloat16"),
)

CATALOGUE: dict[str, HardCase] = {case.name: case for case in _CASES}
"""In the order of the heat map, group by group."""
