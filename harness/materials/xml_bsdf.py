"""A BSDF out of a Mitsuba XML file: the file's only one, or the one of a given id."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from harness.core.protocol.errors import InputError, nearest
from harness.mitsuba_runtime import mitsuba_xml

_CONTEXT = ("default", "texture", "bsdf", "spectrum", "include", "alias")
"""Elements of a scene that a BSDF may refer to."""


def find(path: Path, bsdf_id: str | None, where: str) -> tuple[Element, Element]:
    """``(root, bsdf)`` of the file; ``bsdf_id`` chooses among several.

    Raises:
        InputError: the file has no such BSDF, or several and no id says which.
    """
    root = mitsuba_xml.read(path, where)
    found = [root] if root.tag == "bsdf" else [e for e in root if e.tag == "bsdf"]
    if not found:
        # Without one of its own at the top level, take those inside the shapes.
        found = [e for shape in root.iter("shape") for e in shape if e.tag == "bsdf"]
    if bsdf_id is not None:
        chosen = [e for e in root.iter("bsdf") if e.get("id") == bsdf_id]
        if not chosen:
            hint = nearest(bsdf_id, mitsuba_xml.bsdf_ids(root))
            raise InputError(f"{where}: {path} has no BSDF of id '{bsdf_id}'{hint}")
        return root, chosen[0]
    if not found:
        raise InputError(f"{where}: {path} has no <bsdf>")
    if len(found) > 1:
        ids = ", ".join(mitsuba_xml.bsdf_ids(root)) or "none has an id"
        raise InputError(
            f"{where}: {path} has {len(found)} BSDFs; expected the key 'id' to choose one ({ids})"
        )
    return root, found[0]


def load(path: Path, bsdf_id: str | None, where: str) -> Any:
    """The BSDF as Mitsuba loads it (its variant must be set)."""
    import mitsuba as mi

    root, bsdf = find(path, bsdf_id, where)
    root, bsdf = _with_files(root, path, bsdf)
    # Mitsuba gives no access to the BSDFs of a scene but through shapes that wear them.
    scene = Element("scene", version=root.get("version", ""))
    if root is not bsdf:
        scene.extend(copy.deepcopy(e) for e in root if e.tag in _CONTEXT and e is not bsdf)
    shape = ElementTree.SubElement(scene, "shape", type="rectangle")
    bsdf = copy.deepcopy(bsdf)
    bsdf.attrib.pop("version", None)
    shape.append(bsdf)
    try:
        loaded = mi.load_string(ElementTree.tostring(scene, encoding="unicode"))
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{where}: Mitsuba cannot load {path}: {reason}") from None
    return loaded.shapes()[0].bsdf()


def _with_files(root: Element, path: Path, bsdf: Element) -> tuple[Element, Element]:
    """Copies of ``root`` and of ``bsdf`` in it, with the files they name resolved."""
    index = list(root.iter()).index(bsdf)
    root = copy.deepcopy(root)
    for element, attribute, file in mitsuba_xml.file_values(root, path):
        element.set(attribute, str(file.resolve()))
    return root, list(root.iter())[index]
