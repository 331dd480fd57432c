"""Materials, methods and scenes from what a script has at hand."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core import registry
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.mitsuba_runtime import variant
from harness.mitsuba_runtime.xml_file import checked

MaterialLike = str | Path | Mapping[str, Any] | Material | Any
MethodLike = str | type[Method] | Method


def material(spec: MaterialLike, name: str | None = None, device: str | None = None) -> Material:
    """A material.

    ``spec`` is a name (``harness list materials``), an entry of a suite's ``materials`` as a
    dictionary, a dictionary as ``mitsuba.load_dict`` takes it for a BSDF, a ``mitsuba.BSDF``, or a
    material, which stays as it is. Relative files are meant from the working folder. ``name`` is
    what messages call it. ``device`` is ``"cpu"`` or ``"cuda"``; by default that of the variant of
    Mitsuba that is set, or else the CPU.

    Raises:
        InputError: it is unknown, not to be read, transmits light, reflects nothing, or reads
            what no condition has (docs/own-scenes.md).
    """
    if isinstance(spec, Material):
        return spec
    ready(device)
    from harness.materials import registry as materials

    if isinstance(spec, Mapping):
        return materials.make_tested(checked(_as_in_a_suite(spec, name, materials.KINDS)))
    if isinstance(spec, str):
        return materials.make({"name": spec})
    import mitsuba as mi

    if isinstance(spec, mi.BSDF):
        from harness.materials.mitsuba_bsdf import MitsubaMaterial
        from harness.materials.reflects import check

        made = MitsubaMaterial(name or spec.id() or "own", spec, {"type": "mitsuba-object"})
        check(made)
        return made
    raise InputError(f"material: expected a name, a dictionary or a mitsuba.BSDF, got {spec!r}")


def _as_in_a_suite(spec: Mapping[str, Any], name: str | None, kinds: Any) -> dict[str, Any]:
    """A suite's entry as it is, a Mitsuba dictionary as the entry of type ``mitsuba``."""
    kind = spec.get("type")
    if kind in kinds or "type" not in spec:
        return {"name": name or str(kind or "own"), **spec}
    return {"name": name or str(kind), "type": "mitsuba", "bsdf": dict(spec)}


def method(spec: MethodLike, **parameters: Any) -> Method:
    """A method that is not fitted: by name, as ``file.py:Class``, of a class, or as it is.

    Raises:
        InputError: there is none of that name, or its constructor refuses the ``parameters``.
    """
    if isinstance(spec, Method):
        if parameters:
            raise InputError(f"method '{spec.name}' is made already; parameters go with a class")
        return spec
    if isinstance(spec, str):
        return registry.make(spec, **parameters)
    if not (isinstance(spec, type) and issubclass(spec, Method)):
        raise InputError(f"method: expected a name or a subclass of harness.Method, got {spec!r}")
    if missing := sorted(spec.__abstractmethods__):
        raise InputError(f"method {spec.__name__} does not define {', '.join(missing)}")
    registry.check_parameters(spec.__name__, spec, parameters)
    made = spec(**parameters)
    if not made.name:
        made.name = spec.__name__  # type: ignore[misc]
    return made


def scene(spec: Any) -> Any:
    """A scene: a name (``harness list scenes``) or an entry of a suite's ``scenes``."""
    from harness.scenes import registry as scenes

    if isinstance(spec, Mapping) and "name" not in spec and isinstance(spec.get("file"), str):
        spec = {"name": Path(spec["file"]).stem, **spec}
    return scenes.make(checked(spec))


def ready(device: str | None) -> str:
    """``device`` made ready, or that of the variant of Mitsuba that is set."""
    chosen = device or variant.current()
    variant.use(chosen)
    return chosen
