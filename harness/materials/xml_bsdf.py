"""A BSDF out of a Mitsuba XML file: the file's only one, or the one of a given id."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.mitsuba_runtime import mitsuba_xml
from harness.mitsuba_runtime.mitsuba_xml import MitsubaFile


def find(
    path: Path,
    bsdf_id: str | None,
    where: str,
    parameters: Mapping[str, Any] | None = None,
) -> tuple[MitsubaFile, int]:
    """The file and the index of the BSDF's node in it; ``bsdf_id`` chooses among several.

    Raises:
        InputError: the file has no such BSDF, or several and no id says which.
    """
    file = mitsuba_xml.read(path, where, parameters)
    known = file.ids("BSDF")
    if bsdf_id is not None:
        chosen = [i for i, node in file.nodes("BSDF") if node.props.id() == bsdf_id]
        if not chosen:
            hint = nearest(bsdf_id, known)
            raise InputError(f"{where}: {path} has no BSDF of id '{bsdf_id}'{hint}")
        return file, chosen[0]
    state = file.editable()
    bsdfs = {i for i, _ in mitsuba_xml.nodes(state, "BSDF")}

    def below(nodes: list[Any]) -> list[int]:
        children = [child for node in nodes for _, child in mitsuba_xml.references(node)]
        return [i for i in dict.fromkeys(children) if i in bsdfs]

    # Without one of its own at the top level, take those inside the shapes.
    found = [0] if file.root == "BSDF" else below([state.nodes[0]])
    found = found or below([node for _, node in mitsuba_xml.nodes(state, "Shape")])
    if not found:
        raise InputError(f"{where}: {path} has no <bsdf>")
    if len(found) > 1:
        ids = ", ".join(known) or "none has an id"
        raise InputError(
            f"{where}: {path} has {len(found)} BSDFs; expected the key 'id' to choose one ({ids})"
        )
    return file, found[0]


def load(
    path: Path,
    bsdf_id: str | None,
    where: str,
    parameters: Mapping[str, Any] | None = None,
) -> Any:
    """The BSDF as Mitsuba loads it (its variant must be set)."""
    import mitsuba as mi

    file, index = find(path, bsdf_id, where, parameters)
    state, reference = file.editable(), mi.Properties.ResolvedReference
    if index == 0:
        state.nodes.append(mi.parser.SceneNode(state.nodes[0]))
        index = len(state.nodes) - 1
    # Mitsuba gives no access to the BSDFs of a scene but through shapes that wear them.
    shape = mitsuba_xml.add(state, "Shape", "rectangle", bsdf=reference(index))
    scene = mitsuba_xml.add(state, "Scene", "scene", shape=reference(shape))
    state.nodes[0] = mi.parser.SceneNode(state.nodes[scene])
    return mitsuba_xml.instantiate(state, path.parent, where).shapes()[0].bsdf()
