"""Neural materials by file: the shipped ones, and what a suite names.

{name: theirs, type: neural, file: theirs.ckpt}           # a published checkpoint
{name: mine,   type: neural, file: mine.safetensors}      # written by `harness material train`
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest

SHIPPED = Path(__file__).parent / "shipped"
SUFFIXES = (".ckpt", ".safetensors")


def shipped() -> dict[str, Path]:
    """Files of the materials that come with the harness, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.safetensors"))}


def describe(path: Path) -> str:
    """One line about a stored material."""
    from harness.materials.neural import storage

    return str(storage.record(path).get("about", ""))


def check(path: Path, where: str) -> None:
    """Refuse what is no neural material, as far as name and metadata tell."""
    if path.suffix not in SUFFIXES:
        raise InputError(
            f"{where}: file: expected {' or '.join(SUFFIXES)}, got '{path.name}'"
            f"{nearest(path.suffix, SUFFIXES)}"
        )
    if not path.is_file():
        raise InputError(f"{where}: file: no such file: {path.name}")
    if path.suffix == ".safetensors":
        from harness.materials.neural import storage

        storage.metadata(path, where)


def identity(path: Path, where: str) -> dict[str, Any]:
    """What determines the reflectance: never the file's path, nor its training record."""
    if path.suffix == ".safetensors":
        from harness.materials.neural import storage

        return {"type": "neural", "sha256": storage.reflectance_hash(path, where)}
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from None
    return {"type": "neural", "checkpoint": hashlib.sha256(content).hexdigest()}


def make(name: str, path: Path, what: dict[str, Any]) -> Any:
    """The material, of identity ``what``."""
    from harness.materials.neural import checkpoint, storage
    from harness.materials.neural.material import NeuralMaterial

    where = f"material '{name}'"
    if path.suffix != ".safetensors":
        return NeuralMaterial(name, checkpoint.load(path, where), what)
    material = NeuralMaterial(name, storage.load(path, where), what)
    material.record = storage.record(path)
    return material
