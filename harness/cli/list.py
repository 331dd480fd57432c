"""``harness list``: what there is to name in a suite."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import typer

KINDS = ("methods", "materials", "scenes", "measures", "metrics", "suites", "cases")


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command("list")
    def list_(
        kind: Annotated[str, typer.Argument(help=", ".join(KINDS))],
    ) -> None:
        """Print the names of all methods, materials, scenes, measures, metrics, suites or cases."""
        from harness.core.protocol.errors import InputError, nearest

        if kind not in KINDS:
            raise InputError(f"list: cannot list '{kind}'{nearest(kind, KINDS)}")
        names, describe = _registry(kind)
        rows = {name: describe(name) for name in names}
        width = max(map(len, rows), default=0)
        for name, text in rows.items():
            print(f"{name:{width}}  {text}".rstrip())


def _registry(kind: str) -> tuple[list[str], Callable[[str], str]]:
    if kind == "methods":
        from harness.core import registry

        return registry.names(), registry.describe
    if kind == "materials":
        from harness.materials import registry as materials

        return _materials(materials)
    if kind == "scenes":
        from harness.scenes import registry as scenes

        return scenes.names(), scenes.describe
    if kind == "measures":
        from harness.measures import registry as measures

        return measures.names(), measures.describe
    if kind == "metrics":
        from harness.analysis.metrics import METRICS

        about = {f"{m.measure} {m.name}": f"[{m.unit}] {m.about}" for m in METRICS}
        return list(about), lambda name: about[name]
    if kind == "cases":
        from harness.checks.catalogue import CATALOGUE

        return list(CATALOGUE), lambda name: CATALOGUE[name].about
    from harness.suite import load

    return load.names(), load.describe


def _materials(known: Any) -> tuple[list[str], Callable[[str], str]]:
    """Materials, and described surfaces that a training by walks makes one of."""
    from harness.microgeometry.walks import surfaces

    made = [*known.neural_names(), *known.puresample_names(), *known.names(), *known.family_names()]
    described = [name for name in surfaces.names() if name not in made]

    def describe(name: str) -> str:
        if name in described:
            return f"{surfaces.about(name)} (harness material train {name} --kind puresample)"
        return known.describe(name)

    return [*made, *described], describe
