"""Compiles the kernels with the machine's own compiler, once for a source and a compiler."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from harness.core.cache_folder import cache_folder
from harness.core.compiled.instruction_sets import InstructionSet

SOURCE = Path(__file__).with_name("source")
CONTENT = "326d4c04554c2c6d"
"""First digits of the source's SHA-256: through this name the source counts in digests of code."""
OPTIONS = (
    "-O3", "-std=c++17", "-shared", "-fPIC", "-fno-exceptions", "-fno-math-errno",
    "-ffp-contract=fast",
)  # fmt: skip
COMPILERS = ("c++", "g++", "clang++")
LONGEST = 300.0
"""Seconds that a compiler may take."""


class BuildFailed(Exception):
    """One line that says why there is no library."""


def compiler() -> str | None:
    """Path of the C++ compiler: ``CXX``, or the first of :data:`COMPILERS`."""
    for command in filter(None, (os.environ.get("CXX"), *COMPILERS)):
        if path := shutil.which(command):
            return path
    return None


def digest() -> str:
    """Of the source as it is."""
    files = sorted(file for file in SOURCE.iterdir() if file.suffix in (".cpp", ".h"))
    text = b"".join(file.read_bytes() for file in files)
    return hashlib.sha256(text).hexdigest()[: len(CONTENT)]


def library(target: InstructionSet, folder: Path | None = None) -> Path:
    """The compiled library for ``target``, built into ``folder`` unless it is there.

    A build that failed is noted beside and not tried again with the same source and compiler.

    Raises:
        BuildFailed: no compiler, one that fails, or a folder that cannot be written.
    """
    if digest() != CONTENT:
        raise BuildFailed(
            f"{SOURCE} has the digest {digest()}, and {Path(__file__).name} expects {CONTENT}"
        )
    path = compiler()
    if path is None:
        raise BuildFailed("no C++ compiler found")
    options = (*OPTIONS, *target.options)
    key = hashlib.sha256("\n".join((CONTENT, _version(path), *options)).encode()).hexdigest()[:16]
    folder = folder or cache_folder() / "kernels"
    made, failed = folder / f"columns-{target.name}-{key}.so", folder / f"columns-{key}.failed"
    if made.is_file():
        return made
    with contextlib.suppress(OSError):
        raise BuildFailed(failed.read_text(encoding="utf-8").strip())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as work:
            out = Path(work) / "columns.so"
            trouble = _compile([path, *options, "-o", str(out), str(SOURCE / "columns.cpp")])
            if trouble:
                failed.write_text(trouble, encoding="utf-8")
                raise BuildFailed(trouble)
            # Whole or not at all, for processes that build at the same time.
            os.replace(out, made)
    except OSError as error:
        raise BuildFailed(f"cannot write to {folder}: {error.strerror}") from None
    return made


def _version(path: str) -> str:
    try:
        done = subprocess.run(
            [path, "--version"], capture_output=True, text=True, timeout=60, check=True
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise BuildFailed(f"{path} does not run: {_first_line(str(error))}") from None
    return f"{path} {_first_line(done.stdout)}"


def _compile(command: list[str]) -> str:
    """Empty, or one line that says what went wrong."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return f"{command[0]} took longer than {LONGEST:g} s"
    except OSError as error:
        return f"{command[0]} does not run: {error.strerror}"
    if done.returncode == 0:
        return ""
    lines = [
        line for line in done.stderr.splitlines() if "error" in line
    ] or done.stderr.splitlines()
    return f"{command[0]}: {_first_line(lines[0] if lines else f'status {done.returncode}')}"


def _first_line(text: str) -> str:
    return (text.strip().splitlines() or ["no message"])[0][:200]
