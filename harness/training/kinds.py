"""What is trained here: materials learned from evaluations, and materials learned from walks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.table import Table

from harness.core.protocol.errors import InputError, nearest
from harness.materials.neural import files as neural_files
from harness.materials.puresample import files as walk_files
from harness.microgeometry.walks import surfaces

KINDS = ("neural", "puresample")

Notify = Callable[[str, float], None]


def check(kind: str, description: str) -> None:
    """Refuse, before anything is computed, what a training of ``kind`` cannot follow."""
    if kind not in KINDS:
        raise InputError(f"--kind: unknown kind '{kind}'{nearest(kind, KINDS)}")
    if kind == "neural" and Path(description).stem in surfaces.names():
        raise InputError(
            f"{description}: primitives and facets are walked on and not evaluated; expected"
            " --kind puresample"
        )


def train(
    kind: str,
    description: str,
    out: Path,
    profile: str,
    seed: int,
    device: str,
    resume: bool,
    notify: Notify,
    changes: Sequence[str],
) -> None:
    """See :func:`harness.training.recipe.train` and its namesake from walks."""
    if kind == "puresample":
        from harness.training.puresample import recipe as from_walks

        from_walks.train(description, out, profile, seed, device, notify, changes, resume)
        return
    from harness.training import recipe

    recipe.train(description, out, profile, seed, device, resume, notify, changes)


def interrupted(out: Path) -> str:
    """What to say after Ctrl-C."""
    under_way = out.with_suffix(".train")
    if not under_way.is_file():
        return "interrupted; nothing is stored"
    return f"interrupted; --resume goes on from {under_way}"


def shipped() -> dict[str, Path]:
    """Files of all trained materials that come with the harness, by name."""
    return {**neural_files.shipped(), **walk_files.shipped()}


def file_of(name: str) -> Path:
    """A shipped material's file, or the file itself."""
    known, suffixes = shipped(), neural_files.SUFFIXES
    if name in known:
        return known[name]
    if Path(name).suffix not in suffixes:
        raise InputError(f"unknown neural material '{name}'{nearest(name, known)}")
    if not walk_files.is_one(Path(name)):
        neural_files.check(Path(name), f"material '{name}'")
    return Path(name)


def measure(file: Path, seed: int, device: str) -> None:
    """Measure a material's errors again and rewrite its record."""
    if walk_files.is_one(file):
        from harness.training.puresample import recipe as from_walks

        from_walks.measure(file, seed, device)
        return
    from harness.training import recipe

    recipe.measure(file, seed, device)


def preview(
    file: Path, description: str | None, out: Path, size: int, spp: int, device: str
) -> Path:
    """Draw a material beside the truth: ``spp`` paths a pixel, or 2^14 times as many walks."""
    if walk_files.is_one(file):
        from harness.training.puresample import preview as from_walks

        return from_walks.write(file, description, out, size // 4, spp << 14, device)
    from harness.training import preview as pictures

    return pictures.write(file, description, out, size, spp, device)


def tables(files: list[Path]) -> list[Table]:
    """How materials were trained and how well they answer: a table a kind."""
    from harness.training import report
    from harness.training.puresample import report as from_walks

    walked = [file for file in files if walk_files.is_one(file)]
    others = [file for file in files if file not in walked]
    found = [report.table(others)] if others else []
    return found + ([from_walks.table(walked)] if walked else [])
