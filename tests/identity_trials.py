"""A trial of every sort, as the parts whose code its numbers come from; and copies of the tree."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from harness.core.paths import ROOT
from harness.identity import ours
from harness.identity.cache import Cache
from harness.identity.digests import Digests, Part, SourceDigest
from harness.identity.tree import Tree
from harness.measures import registry as measures
from harness.scenes import registry as scenes
from harness.suite import source_parts
from harness.suite.trials import FIT

TRIALS: Mapping[str, tuple[str, Any, str, Any]] = {
    "render": ("improved-baseline", "suede", "equal-spp", "studio-sphere"),
    "fit": ("improved-baseline", "suede", "fit", None),
    "timed": ("neural-spline-flow", "suede", "equal-time", "draped-cloth"),
    "neural": ("two-lobe", "leather", "effects", "shelf"),
    "walks": ("random-walk", "ggx-conductor", "sample-weights", None),
    "pdf": ("blinn-phong", "layered", "pdf", None),
    "maps": ("importance-baked", "disney", "fit", None),
    "checks": ("histogram", "rim-lobe", "stability", None),
    "traced": ("cosine", "leather", "levels", None),
}
"""Method, material, measure and scene by the name of the trial."""

_CACHE = Cache()


def digests_of(root: Path, names: Any = TRIALS) -> dict[str, dict[str, SourceDigest]]:
    """Digests by trial and part, of the source text below ``root`` as it is now."""
    known = digests_below(root)
    return {name: of_trial(known, name) for name in names}


def digests_below(root: Path) -> Digests:
    """Of a copy of the tree; files that did not change are parsed once in a process."""
    roots = {top: root / top for top in ("harness", "methods")}
    tree = Tree(roots, cut=ours.TABLES, by_name=ours.BY_NAME, cache=_CACHE)
    return Digests(tree)


def of_trial(known: Digests, name: str) -> dict[str, SourceDigest]:
    """Digests of the parts of the trial called ``name``."""
    method, material, measure, scene = TRIALS[name]
    part = scene_part(scene) if scene else None
    parts = source_parts.parts_of(known, method, material, measures.load(measure), part)
    return source_parts.of_trial(known, parts, measure == FIT)


@lru_cache
def scene_part(name: str) -> Part:
    """Where the code of a named scene begins."""
    made = scenes.make(name)
    return source_parts.scene(name, made, [s.material for s in made.shapes if s.material])


def copy_of_tree(folder: Path) -> Path:
    """The source text of the project, copied into ``folder``, and these helpers; data by links."""
    data = ("*.safetensors", "*.ckpt")
    for top in ("harness", "methods"):
        ignored = shutil.ignore_patterns("__pycache__", *data)
        shutil.copytree(ROOT / top, folder / top, symlinks=True, ignore=ignored)
        for file in (file for pattern in data for file in (ROOT / top).rglob(pattern)):
            (folder / file.relative_to(ROOT)).symlink_to(file)
    (folder / "tests").mkdir()
    for name in ("__init__", "identity_trials", "identity_probes"):
        shutil.copy(ROOT / "tests" / f"{name}.py", folder / "tests")
    return folder
