"""Materials learned from walks by file: the shipped ones, and what a suite names.

Their networks load Dr.Jit, and are imported where a file is read: a list of names needs none.

{name: mine, type: puresample, file: mine.safetensors}    # harness material train --kind puresample
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest

SHIPPED = Path(__file__).parent / "shipped"
SUFFIXES = (".safetensors",)


def shipped() -> dict[str, Path]:
    """Files of the materials that come with the harness, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.safetensors"))}


def describe(path: Path) -> str:
    """One line about a stored material."""
    from harness.materials.puresample import storage

    return str(storage.record(path).get("about", ""))


def is_one(path: Path) -> bool:
    """Whether a file says that it is a material learned from walks."""
    from harness.materials.puresample import storage

    try:
        return bool(storage.metadata(path))
    except InputError:
        return False


def check(path: Path, where: str) -> None:
    """Refuse what is no material learned from walks, as far as name and metadata tell."""
    if path.suffix not in SUFFIXES:
        raise InputError(
            f"{where}: file: expected {SUFFIXES[0]}, got '{path.name}'"
            f"{nearest(path.suffix, SUFFIXES)}"
        )
    if not path.is_file():
        raise InputError(f"{where}: file: no such file: {path.name}")
    from harness.materials.puresample import storage

    storage.metadata(path, where)


def identity(path: Path, where: str) -> dict[str, Any]:
    """What determines the reflectance: never the file's path, nor its training record."""
    from harness.materials.puresample import storage

    return {"type": "puresample", "sha256": storage.reflectance_hash(path, where)}


def make(name: str, path: Path, what: dict[str, Any]) -> Any:
    """The material, of identity ``what``."""
    from harness.materials.puresample import storage
    from harness.materials.puresample.material import PureSampleMaterial

    material = PureSampleMaterial(name, storage.load(path, f"material '{name}'"), what)
    material.record = storage.record(path)
    return material
