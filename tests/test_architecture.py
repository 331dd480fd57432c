"""Imports go one way: the layers of docs/architecture.md, from the command line down."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = """
    cli harness api bench fuzz runner report suite measures checks rendering scenes training
    materials microgeometry geometry methods importance_maps fitting nets textures analysis store
    effects mitsuba_runtime identity stats core
""".split()
"""From the top down. A package imports itself and what stands after it; ``harness`` is the
package's own ``__init__`` with the public names."""
ALONE = {"stats": {"numpy", "scipy"}, "geometry": {"numpy"}, "textures": {"numpy"}}
"""Packages that import nothing of ours but ``core``, and of others only these."""
PUBLIC = ROOT / "harness" / "__init__.py"
OF_OURS = re.compile(r"material|method|scene|surface")
"""Objects of the protocol: what they have or lack is said by the protocol."""


@cache
def modules() -> dict[str, Path]:
    """Every module of the harness and of the shipped methods, by its full name."""
    found = {}
    for folder in ("harness", "methods"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            parts = list(file.relative_to(ROOT).with_suffix("").parts)
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


@cache
def tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text("utf-8"), str(file))


def package(module: str) -> str:
    """The layer of a module: the second part of its name, or ``methods``."""
    parts = module.split(".")
    return parts[0] if parts[0] == "methods" or len(parts) == 1 else parts[1]


def for_types(file: Path) -> set[ast.AST]:
    """The imports under ``if TYPE_CHECKING``, which never run."""
    return {
        inner
        for node in ast.walk(tree(file))
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in node.body
    }


def imports(module: str, types: bool = True) -> Iterator[tuple[str, int]]:
    """Modules that it names in an import, inside functions too, with the line.

    ``types``: with those that serve annotations alone.
    """
    known = modules()
    left_out = set() if types else for_types(known[module])
    for node in ast.walk(tree(known[module])):
        if node in left_out:
            continue
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{known[module]}:{node.lineno}: relative import"
            for alias in node.names:
                # The package that the shipped methods are imported from: a link to their folder.
                base = str(node.module).replace("harness._methods", "methods")
                inner = f"{base}.{alias.name}"
                yield (inner if inner in known else base), node.lineno


def ours(types: bool = True) -> Iterator[tuple[str, str, str]]:
    """(importing module, imported module, where) for all imports of our own modules."""
    for module, file in modules().items():
        for name, line in imports(module, types):
            if name.split(".")[0] in ("harness", "methods"):
                yield module, name, f"{file.relative_to(ROOT)}:{line} imports {name}"


def test_every_package_has_a_layer():
    # __main__ starts the command line; it belongs to it.
    assert {package(module) for module in modules()} - {"__main__"} == set(LAYERS)


def test_no_import_climbs():
    """With every import going down a list of packages, no two packages form a circle."""
    place = {name: i for i, name in enumerate(LAYERS)}
    place["__main__"] = 0
    climbing = [
        where for a, b, where in ours() if place[package(b)] < place[package(a)]
    ]  # fmt: skip
    assert not climbing, "\n".join(climbing)


def test_no_file_is_part_of_a_circle():
    known = modules()
    graph: dict[str, set[str]] = {name: set() for name in known}
    for a, b, _ in ours(types=False):
        if b in known and b != a:
            graph[a].add(b)
    while True:  # take away what imports nothing that is left; a circle never goes
        free = {a for a, to in graph.items() if not to & graph.keys()}
        if not free:
            break
        graph = {a: to for a, to in graph.items() if a not in free}
    left = {a: sorted(to & graph.keys()) for a, to in graph.items()}
    assert not left, left


@pytest.mark.parametrize("name", ALONE)
def test_packages_that_stand_alone(name: str):
    for module in modules():
        if package(module) == name:
            for imported, line in imports(module):
                root = imported.split(".")[0]
                if root == "harness":
                    assert package(imported) in (name, "core"), (module, line, imported)
                elif root in ("torch", "mitsuba", "drjit", "pandas", "matplotlib"):
                    assert root in ALONE[name], (module, line, imported)


def test_the_protocol_imports_nothing_of_ours_above_it():
    for module in modules():
        if module.startswith("harness.core.protocol"):
            for imported, line in imports(module):
                if imported.startswith("harness"):
                    assert imported.startswith("harness.core"), (module, line, imported)


def test_no_init_hands_names_on():
    """``from package import name`` would hide the file that a trial depends on."""
    for file in modules().values():
        if file.name == "__init__.py" and file != PUBLIC:
            body = tree(file).body
            assert all(isinstance(node, ast.Expr) for node in body), file


def test_nothing_reaches_into_an_object_of_the_protocol():
    """``getattr(material, "bsdf", None)`` is a method or attribute of the protocol instead.

    ``callable(getattr(material, "slices", None))`` is the question whether an optional method of
    the protocol is there, and may be asked.
    """
    found = []
    for module, file in modules().items():
        asked = {
            id(argument)
            for node in ast.walk(tree(file))
            if _calls(node, "callable")
            for argument in node.args
        }
        for node in ast.walk(tree(file)):
            if not (_calls(node, "getattr") or _calls(node, "hasattr")) or id(node) in asked:
                continue
            holder, key = node.args[0], node.args[1]
            name = holder.attr if isinstance(holder, ast.Attribute) else getattr(holder, "id", "")
            if isinstance(key, ast.Constant) and OF_OURS.fullmatch(name):
                found.append(f"{module}:{node.lineno}: {ast.unparse(node)}")
    assert not found, "\n".join(found)


def test_only_one_place_sets_mitsubas_variant():
    for module, file in modules().items():
        for node in ast.walk(tree(file)):
            if isinstance(node, ast.Attribute) and node.attr == "set_variant":
                assert module == "harness.mitsuba_runtime.variant", (module, node.lineno)


def _calls(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name


def test_the_documented_layers_are_those():
    text = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    block = text[text.index("    cli\n") : text.index("`tests/test_architecture.py` holds")]
    listed = re.findall(r"[a-z_]+", block)
    place = {name: i for i, name in enumerate(LAYERS)}
    assert set(listed) == set(LAYERS) - {"harness"}
    assert [place[name] for name in listed] == sorted(place[name] for name in listed)


def test_no_file_of_tests_is_long():
    """A long one tests several subjects."""
    for file in (ROOT / "tests").glob("*.py"):
        assert len(file.read_text("utf-8").splitlines()) < 450, file.name
