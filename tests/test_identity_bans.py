"""What would make digests of code blind: hidden imports, and names that a package re-exports."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import lru_cache

from harness.core.paths import ROOT

BY_HAND = {
    "harness/core/registry.py": "methods by name; an adapter's file is an entry of its trials",
    "harness/materials/registry.py": "a library material by name, which is an entry",
    "harness/materials/families/registry.py": "a family by name, which is an entry",
    "harness/materials/families/ggx.py": "the module of a Dr.Jit array",
    "harness/materials/families/hashing.py": "the module of a Dr.Jit array",
    "harness/measures/registry.py": "a measure by name, which is an entry",
    "harness/mitsuba_runtime/python_plugins.py": "a user's file, whose content is in the key",
}
"""Counted files that import by a name made at run time, and why that is no hole."""

NOT_COUNTED = (
    "harness/__init__.py",
    "harness/cli",
    "harness/fuzz",
    "harness/report",
    "harness/analysis",
    "harness/runner",
    "harness/store",
    "harness/suite",
)
"""They carry out, store, show and try; what of their numbers counts is in records' own digests."""


@lru_cache
def counted() -> list[tuple[str, ast.Module]]:
    """Counted files with their syntax trees."""
    return list(_counted())


def _counted() -> Iterator[tuple[str, ast.Module]]:
    for top in ("harness", "methods"):
        for file in sorted((ROOT / top).rglob("*.py")):
            name = file.relative_to(ROOT).as_posix()
            if not name.startswith(NOT_COUNTED):
                yield name, ast.parse(file.read_text(encoding="utf-8"))


def called(node: ast.AST) -> str:
    if not isinstance(node, ast.Call):
        return ""
    return ast.unparse(node.func).rpartition(".")[2]


def test_no_package_of_counted_code_exports_what_others_define():
    for name, tree in counted():
        if name.endswith("__init__.py"):
            found = [n for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom)]
            assert not found, f"{name}, line {found[0].lineno}: imports; say where things are"


def test_code_is_imported_by_import_statements():
    hidden = {"import_module", "__import__", "spec_from_file_location", "exec", "run_path"}
    found = {name for name, tree in counted() for n in ast.walk(tree) if called(n) in hidden}
    assert found == set(BY_HAND)


def test_no_name_is_imported_by_a_star():
    for name, tree in counted():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                assert all(alias.name != "*" for alias in node.names), f"{name}: {node.lineno}"


def test_no_table_of_what_may_run_is_filled_from_elsewhere():
    # A value that another module writes into is read without anything that says so.
    for name, tree in counted():
        own = {n.id for s in tree.body for n in ast.walk(s) if isinstance(n, ast.Name)
               and isinstance(n.ctx, ast.Store)}  # fmt: skip
        imported = {
            alias.asname or alias.name
            for node in tree.body
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("harness")
            for alias in node.names
        }
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AugAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                for target in targets:
                    if isinstance(target, ast.Subscript | ast.Attribute):
                        root = ast.unparse(target).split(".")[0].split("[")[0]
                        assert root in own and root not in imported, f"{name}: {node.lineno}"
