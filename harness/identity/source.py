"""The source text that a trial's hash covers.

The rule: the file itself and every file that it imports, followed through, as long as it
lies beside it (same folder, same package) or in a part of the harness that can change a
number (``COUNTED``). Comments, docstrings, blank lines and trailing space do not count: to
explain code better must not cost a night of computing. Imports are read from the source
text; nothing is executed.
"""

from __future__ import annotations

import ast
import hashlib
import io
import tokenize
from functools import lru_cache
from pathlib import Path

from harness.core.paths import ROOT
from harness.core.protocol.errors import InputError

COUNTED = (
    "methods",
    "harness.core.protocol",
    "harness.core.columns",
    "harness.nets",
    "harness.fitting",
    "harness.importance_maps",
    "harness.stats",
    "harness.effects",
    "harness.scenes",
    "harness.materials",
    "harness.microgeometry",
    "harness.rendering",
    "harness.checks",
    "harness.measures",
)
UNCOUNTED = frozenset(
    {
        # They find, name, check or refuse things and hold no arithmetic.
        "harness.core.protocol.errors",
        "harness.effects.registry",
        "harness.materials.registry",
        "harness.measures",
        "harness.measures.base",
        "harness.measures.adapter_smoke_test",
        "harness.measures.registry",
        "harness.mitsuba_runtime.llvm",
        "harness.mitsuba_runtime.variant",
        "harness.scenes.registry",
    }
)


def essence(text: str) -> str:
    """``text`` without comments, bare strings, blank lines and trailing space."""
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(text)):
        # A string as a statement of its own is a docstring or an attribute's; keep one that
        # shares its line with code.
        if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            continue
        alone = lines[node.lineno - 1].lstrip()[:1] in "'\"rR"
        if alone and isinstance(node.value.value, str):
            for row in range(node.lineno - 1, node.end_lineno or node.lineno):
                lines[row] = ""
    return "\n".join(line.rstrip() for line in lines if line.strip())


def read(path: Path) -> str:
    """Text of a Python file; an :class:`InputError` if it cannot be read or parsed."""
    try:
        text = path.read_text(encoding="utf-8")
        ast.parse(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (SyntaxError, ValueError) as error:
        line = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{path}{line}: not valid Python: {error}") from None
    return text


def covered(path: Path, package: str = "") -> str:
    """All source text that the file ``path`` stands for, in an order of its own.

    ``package``: dotted name of the package the file belongs to, ``""`` for a lone file.
    """
    module = f"{package}.{path.stem}" if package else path.stem
    folder = path.parent
    for _ in package.split(".") if package else ():
        folder = folder.parent
    found: dict[str, str] = {}
    queue = [(module, path)]
    while queue:
        name, file = queue.pop()
        if name in found:
            continue
        stamp = file.stat()
        inside = name if file.name == "__init__.py" else name.rpartition(".")[0]
        found[name], targets = _parsed(file, inside, (stamp.st_mtime_ns, stamp.st_size))
        for target in targets:
            located = _locate(target, folder, package.partition(".")[0])
            if located and target not in UNCOUNTED:
                queue.append((target, located))
    return "\n".join(f"# {name}\n{found[name]}" for name in sorted(found))


def digest(text: str) -> str:
    """First 16 hex digits of the SHA-256 of ``text``."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@lru_cache(maxsize=512)
def _parsed(file: Path, inside: str, stamp: tuple[int, int]) -> tuple[str, frozenset[str]]:
    """Essence and imports of one file; ``stamp`` keeps an edited file from being remembered."""
    text = read(file)
    return essence(text), frozenset(_imported(text, inside))


def _imported(text: str, inside: str) -> set[str]:
    """Dotted names a source text imports; ``inside`` is the package it is part of."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = inside.split(".") if inside else []
                parents = parents[: len(parents) - node.level + 1]
                base = ".".join([*parents, *([base] if base else [])])
            if base:
                names.add(base)
            names |= {f"{base}.{alias.name}".lstrip(".") for alias in node.names}
    # `from harness import Method` is a short name of the protocol.
    return {"harness.core.protocol" if name == "harness" else name for name in names}


def _locate(name: str, folder: Path, top: str) -> Path | None:
    """File of the module ``name`` if the rule above covers it."""
    head = name.partition(".")[0]
    if head in ("harness", "methods"):
        if not any(name == part or name.startswith(part + ".") for part in COUNTED):
            return None
        base = ROOT
    elif not top or head == top:
        base = folder
    else:
        return None
    stem = base.joinpath(*name.split("."))
    for file in (stem.with_suffix(".py"), stem / "__init__.py"):
        if file.is_file():
            return file
    return None
