"""The source tree of this project, as :mod:`harness.identity` follows it."""

from __future__ import annotations

import atexit
from functools import lru_cache
from pathlib import Path

from harness.core.cache_folder import cache_folder
from harness.core.classes import named
from harness.core.paths import METHODS, ROOT
from harness.identity.cache import Cache
from harness.identity.digests import Digests, Part
from harness.identity.modules import CALLED
from harness.identity.tree import Tree

TABLES = (
    "harness.core.registry:load",
    "harness.effects.registry:EFFECTS",
    "harness.materials.hard.registry:MATERIALS",
    "harness.materials.registry:KINDS",
    "harness.scenes.library:SCENES",
)
"""Units from which one entry is chosen by name."""


def _shipped_method(name: str) -> list[str]:
    # The registry's own name for this folder would load PyTorch, which a report does without.
    found = named(METHODS).get(name)
    return [f"methods.{found.file.stem}:{found.class_name}"] if found else []


BY_NAME = {"harness.core.registry:make": _shipped_method}
"""Functions that find something by name, and the unit that a name stands for."""


def digest_of(part: Part) -> str:
    """Of all code of ours that ``part`` reaches."""
    return digests().of({"": part})[""].digest


def digest_of_class(file: Path, class_name: str) -> str:
    """Of all code that a class in a lone file reaches: there, in files beside it, and of ours.

    As the files are now, for they may change while a process runs.

    Raises:
        KeyError: there is no such class.
    """
    known = digests().tree
    tree = Tree(known.roots, cut=TABLES, by_name=BY_NAME, cache=known.cache)
    entry = f"{tree.add_folder(file.parent)}.{file.stem}:{class_name}"
    return Digests(tree).of({"": Part((entry,))})[""].digest


@lru_cache(maxsize=8)
def digests(root: Path = ROOT, cached: bool = True) -> Digests:
    """Digests of the tree below ``root``, as it is when they are first asked for."""
    cache = Cache(cache_folder() if cached else None)
    atexit.register(cache.save)  # once: it is a file of megabytes
    folder = root / "harness"
    roots = {"harness": folder, CALLED: (folder / "_methods").resolve()}
    return Digests(Tree(roots, cut=TABLES, by_name=BY_NAME, cache=cache))
