"""What walks can be drawn from: described surfaces, and families that walk by themselves."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.errors import InputError
from harness.core.streams import generator
from harness.core.yamlfile import read_yaml
from harness.materials import registry
from harness.materials.families.walks import WalkFamily
from harness.microgeometry import descriptions
from harness.microgeometry.walks import surfaces
from harness.microgeometry.walks.description import parse
from harness.microgeometry.walks.kernel import Counts, Exits
from harness.microgeometry.walks.surface import WALKED
from harness.training.puresample.normal_mapped import KEYS, NormalMapped

FAMILIES = descriptions.DESCRIPTIONS / "walks"
"""Descriptions that are only walked on: families, and what the paper's Figures 6 to 8 are after."""


class FamilyWalks:
    """A family of random walks with all its parameters fixed, as a source of particles.

    Its walks carry weights rgb of at most one. A particle of one channel leaves with the weight's
    probability, which keeps its own at one (PureSample, appendix C).
    """

    grey = False

    def __init__(self, material: WalkFamily, about: str):
        self.material, self.name, self.about = material, material.name, about
        if material.n_features:
            free = ", ".join(p.name for p in material.parameters)
            raise InputError(f"{self.name}: expected all parameters fixed; free: {free}")

    def identity(self) -> dict[str, Any]:
        """What determines its walks, as JSON data."""
        return self.material.identity()

    def walk(self, u: Tensor, wi: Tensor, channel: Tensor, seed: int, device: str = "cpu") -> Exits:
        """One particle a row, as :func:`harness.microgeometry.walks.kernel.walk`; no place counts.

        ``interactions`` are one a walk: what happens inside is the family's own.
        """
        random = torch.rand(len(wi), 4, generator=generator(seed)).to(device)
        wo, weight = self.material.walk_sample(wi.to(device), random[:, :3].contiguous())
        kept = weight.gather(1, channel.to(device).long()[:, None])[:, 0]
        left = random[:, 3] < kept
        wo = torch.where(left[:, None], wo, 0)
        counts = Counts(
            walks=len(wi),
            left=int(left.sum()),
            interactions=len(wi),
            above_one=int((kept > 1 + 1e-5).sum()),
        )
        return Exits(wo, left, torch.ones(len(wi), dtype=torch.int32), counts)


def load(name: str | Path) -> Any:
    """The source of a description, given by file or by name.

    Beside the surfaces of :mod:`harness.microgeometry.walks.surfaces`, a mapping with ``family``::

        name: my-coat
        about: "rough varnish over a matt base"
        family: layered
        fix: {eta: 1.5, alpha: 0.1, ...}
        fields: {dents: ...}                   # with a normal map, as a relief's micro normals
        micro: {field: dents, depth: 0.02}

    Raises:
        InputError: one line that names the file and what was expected.
    """
    file = _find(name)
    data = read_yaml(file, "a description in YAML") if file.suffix == ".yaml" else None
    if not isinstance(data, Mapping) or "family" not in data:
        return surfaces.load(file)
    about = str(data.get("about", ""))
    spec = {key: value for key, value in data.items() if key != "about"}
    try:
        return _family(spec, about)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def _find(name: str | Path) -> Path:
    """The file; a bare name may be one of the families' too, which are in a folder of their own."""
    own = FAMILIES / f"{name}.yaml"
    return own if Path(name).name == str(name) and own.is_file() else descriptions.find(name)


def _family(spec: Mapping[str, Any], about: str) -> FamilyWalks | NormalMapped:
    words = {key: spec[key] for key in KEYS if key in spec}
    own = {key: value for key, value in spec.items() if key not in words}
    material = registry.make({"type": "family", **own})
    if not isinstance(material, WalkFamily):
        raise InputError(f"family '{spec['family']}' has no random walk")
    family = FamilyWalks(material, about)
    return NormalMapped(family, words) if words else family


def of_record(record: Mapping[str, Any]) -> Any:
    """The source that a material was learned from, as its record describes it.

    Beds, facet fields and families are made of the record alone; a relief is found by its name, for
    materials learned from evaluations too.

    Raises:
        InputError: it cannot be found, or is another now.
    """
    name, known = str(record["name"]), record["description"]
    about = str(record.get("about", ""))
    if "family" in known:
        spec = {key: value for key, value in known.items() if key != "type"}
        source = _family({"name": name, **spec}, about)
    elif known.get("type") == WALKED:
        source = parse({"name": name, "about": about, **known["description"]})
    else:
        source = surfaces.load(name)
    now = json.loads(json.dumps(source.identity()))
    # The hash of the code that traces a relief changes with every word of it.
    if {**now, "source": ""} != {**known, "source": ""}:
        raise InputError(f"description '{name}' has changed since")
    return source
