"""What one run of ``harness check`` covers: materials, each with ordinary and hard cases."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

from harness.checks import properties
from harness.checks.approximate_pdf import as_declared
from harness.checks.catalogue import BASE, CATALOGUE, HardCase
from harness.checks.finding import Finding
from harness.checks.run import FALSE_ALARM, ORDINARY, case_tests, fit, hard, ordinary
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.method import Method
from harness.materials import registry as materials
from harness.stats.chisquare import sidak

DEFAULT_MATERIALS = (BASE, "brushed-metal")
"""One near-diffuse, one anisotropic and glossy."""

DEFAULT_CASES = ("specular-1e-3", "black-texels", "rim-lobe", "distant-lobes", "measured-holes")
"""Hard cases with a material of their own, so a fit each, that run without being asked for:
a narrow lobe, 0/0, the disk's edge, several lobes, and signs."""

MITSUBA = "mitsuba-chi2"
MITSUBA_TESTS = 4
"""One for each inclination."""


@dataclass(frozen=True)
class Part:
    """One material with one fit: its ordinary cases or not, and cases of the catalogue."""

    material: str
    ordinary: bool = False
    cases: tuple[HardCase, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Parts, and the names of the properties wanted, all where there are none."""

    parts: tuple[Part, ...]
    only: tuple[str, ...] = ()
    mitsuba: bool = False
    level: float = field(init=False)
    """Of each statistical test, such that all of them together keep to ``FALSE_ALARM``."""

    def __post_init__(self) -> None:
        each = ORDINARY * properties.tests(self.only) + MITSUBA_TESTS * self.mitsuba
        tests = sum(
            each * part.ordinary + sum(case_tests(case, self.only) for case in part.cases)
            for part in self.parts
        )
        object.__setattr__(self, "level", sidak(FALSE_ALARM, max(1, tests)))


def make_plan(
    wanted_materials: Iterable[str] = (),
    wanted_cases: Iterable[str] = (),
    wanted_properties: Iterable[str] = (),
    *,
    everything: bool = False,
    mitsuba: bool = False,
) -> Plan:
    """The plan for what the command line asks.

    Without any wish: the ordinary cases of the default materials, all cases of the catalogue
    with the material ``BASE``, and a few others. ``everything`` takes the whole catalogue.
    Cases that are one property by another name run only when named, for the ordinary cases
    have run it already.

    Raises:
        InputError: an unknown material, case or property.
    """
    asked_materials, asked_cases = list(wanted_materials), list(wanted_cases)
    only = tuple(wanted_properties)
    for name in asked_materials:
        materials.validate(name)
    known = [*properties.names(), MITSUBA]
    for name in only:
        if name not in known:
            raise InputError(f"unknown property '{name}'{nearest(name, known)}")
    for name in asked_cases:
        if name not in CATALOGUE:
            raise InputError(f"unknown case '{name}'{nearest(name, CATALOGUE)}")
    cases = [CATALOGUE[name] for name in dict.fromkeys(asked_cases)]
    if everything:
        cases += [c for c in CATALOGUE.values() if not c.inputs and c not in cases]
    if not (asked_cases or asked_materials or everything):
        cases = [c for c in CATALOGUE.values() if _by_default(c)]
    if not (asked_materials or asked_cases):
        asked_materials = list(DEFAULT_MATERIALS)
    mitsuba = mitsuba or MITSUBA in only
    parts = {name: Part(name, ordinary=True) for name in asked_materials}
    for case in cases:
        part = parts.get(case.material, Part(case.material))
        parts[case.material] = replace(part, cases=(*part.cases, case))
    return Plan(tuple(parts.values()), only, mitsuba)


def _by_default(case: HardCase) -> bool:
    return not case.inputs and (case.material == BASE or case.name in DEFAULT_CASES)


def carry_out(
    plan: Plan, part: Part, method: Method, seed: int, device: str
) -> Iterator[tuple[Finding, HardCase | None]]:
    """Findings of one part as they are made, each with its case of the catalogue, if of one.

    ``method`` is a fresh one, and fitted here.

    Raises:
        Unsupported: the method does not take the part's material.
    """
    material = materials.make(part.material)
    subject, fitting = fit(method, material, seed, device=device)
    for finding in fitting:
        if not plan.only or finding.property in plan.only or not finding.ok:
            yield finding, None
    if subject is None:
        return
    if part.ordinary:
        for finding in ordinary(subject, plan.level, plan.only):
            yield finding, None
    for case in part.cases:
        for finding in hard(subject, case, plan.level, plan.only):
            yield finding, case
    if part.ordinary and plan.mitsuba:
        from harness.checks.mitsuba_chi2 import mitsuba_chi2

        alpha = 1 - (1 - plan.level) ** MITSUBA_TESTS
        for finding in mitsuba_chi2(method, material, seed, device=device, alpha=alpha):
            yield as_declared(method, finding), None
