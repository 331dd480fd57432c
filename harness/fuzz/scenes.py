"""Spoiled scene files: Mitsuba's XML, its elements, its values and its text."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from harness.core.paths import SUITES
from harness.fuzz import mutations
from harness.fuzz.attempt import Fuzz
from harness.mitsuba_runtime import mitsuba_xml
from harness.mitsuba_runtime.xml_file import checked
from harness.runner import preflight
from harness.scenes import registry as scenes
from harness.scenes import xml
from harness.scenes.base import XmlScene

_SMALL = """<scene version="3.0.0">
    <default name="roughness" value="0.2"/>
    <default name="part" value="part"/>
    <sensor type="perspective"><float name="fov" value="45"/>
        <film type="hdrfilm"><integer name="width" value="8"/></film></sensor>
    <emitter type="constant"><spectrum name="radiance" filename="light.spd"/></emitter>
    <bsdf type="roughconductor" id="metal"><float name="alpha" value="$roughness"/></bsdf>
    <shape type="obj"><string name="filename" value="ball.obj"/><ref id="metal"/></shape>
    <include filename="$part.xml"/>
</scene>
"""
_PART = """<scene version="3.0.0"><shape type="sphere"><ref id="metal"/></shape></scene>"""
_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
_LIGHT = "400 1.0\n700 2.0\n"
_TAGS = (
    "scene", "include", "default", "bsdf", "shape", "emitter", "ref", "path", "alias", "texture",
    "transform", "lookat", "matrix", "float", "string", "integer", "boolean", "rgb", "spectrum",
    "point", "vector", "object", "medium", "sampler", "x:y", "a" * 300,
)  # fmt: skip
_NAMES = ("name", "value", "filename", "type", "id", "version", "x", "origin", "angle", "a" * 300)
_VERSIONS = ("", "0", "0.4.0", "1", "3.0", "3.0.0", "9999.0.0", "-1.0.0", "a.b.c", "3" * 5000)
_DEPTHS = (20, 200, 2_000, 100_000)


class Scenes(Fuzz):
    """Each is read and described as a suite's scene, and its identity is taken; some are built."""

    def __init__(self, folder: Path):
        super().__init__(folder)
        preflight.ready("cpu")
        corner = (SUITES / "scenes" / "corner.xml").read_text("utf-8")
        self.texts = {_SMALL: "metal", corner: "fabric"}

    def attempt(self, rng: Random) -> None:
        """See :class:`Fuzz`."""
        text = rng.choice(sorted(self.texts))
        spec: dict[str, Any] = {"file": "scene.xml", "replace_bsdf": self.texts[text]}
        whole = {
            "scene.xml": text.encode(),
            "part.xml": _PART.encode(),
            "ball.obj": _OBJ.encode(),
            "light.spd": _LIGHT.encode(),
        }
        odd = "scene.xml" if rng.random() < 0.85 else rng.choice(sorted(whole))
        way = rng.choice(_WAYS) if odd.endswith(".xml") else _bytes
        whole[odd] = way(whole[odd].decode(), rng)
        if rng.random() < 0.2:
            spec = mutations.spoiled(spec | {"parameters": {"roughness": 0.3}}, rng)
        for name, content in whole.items():
            (self.folder / name).write_bytes(content)
        if not isinstance(spec, dict):
            return
        if isinstance(file := spec.get("file"), str):
            spec["file"] = str(self.folder / file)
        made = scenes.make(checked(spec), self.folder)
        if not isinstance(made, XmlScene):
            return
        xml.identity(made, self.folder)
        if rng.random() < 0.1:
            source = mitsuba_xml.read(made.file, "scene 'scene'", made.parameters)
            mitsuba_xml.instantiate(source.editable(), self.folder, "scene 'scene'")


def _bytes(text: str, rng: Random) -> bytes:
    return mutations.damaged(text.encode(), rng)


def _elements(text: str, rng: Random) -> bytes:
    """A few elements or attributes changed, removed, doubled or moved."""
    root = ElementTree.fromstring(text)
    for _ in range(1 + rng.randrange(3)):
        owners = [e for e in root.iter() if len(e)]
        owner: Element = rng.choice(owners) if owners else root
        inner: Element = rng.choice(list(root.iter()))
        kind = rng.randrange(7)
        if kind == 0 and len(owner):
            owner.remove(rng.choice(list(owner)))
        elif kind == 1:
            owner.append(copy.deepcopy(inner))
        elif kind == 2:
            inner.tag = rng.choice(_TAGS)
        elif kind == 3 and inner.attrib:
            del inner.attrib[rng.choice(sorted(inner.attrib))]
        elif kind == 4:
            inner.set(rng.choice(_NAMES), _text(rng))
        elif inner.attrib:
            inner.set(rng.choice(sorted(inner.attrib)), _text(rng))
    if rng.random() < 0.1:
        root.set("version", rng.choice(_VERSIONS))
    encoding = rng.choice(("utf-8", "utf-8", "utf-16", "latin-1"))
    return ElementTree.tostring(root, encoding).replace(b"&amp;#", b"&#")


def _text(rng: Random) -> str:
    """An attribute's value; some of characters that XML does not have."""
    found = rng.choice(
        (
            *("$roughness", "$" * 50, "$part" * 300, "1, 2", "0.1 0.2 0.3 0.4", "metal"),
            *("part.xml", "scene.xml", "light.spd", "ball.obj", ".", "..", "&#27;[31m", "1e999"),
            str(rng.choice(mutations.NUMBERS)),
            rng.choice(mutations.TEXTS),
        )
    )
    return found.encode("utf-8", "replace").decode()


def _deep(text: str, rng: Random) -> bytes:
    """Elements in one another."""
    tag, depth = rng.choice(("bsdf", "shape", "scene", "transform")), rng.choice(_DEPTHS)
    kind = ' type="twosided"' if rng.random() < 0.5 else ""
    inner = f"<{tag}{kind}>" * depth + f"</{tag}>" * depth
    return text.replace("<bsdf", inner + "<bsdf", 1).encode()


def _entities(text: str, rng: Random) -> bytes:
    """Entities that stand for more and more of others, for a file, or for themselves."""
    kind = rng.randrange(3)
    if kind == 0:
        lines = ['<!ENTITY a0 "aaaaaaaaaa">']
        lines += [f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, rng.choice((4, 10)))]
    elif kind == 1:
        lines = ['<!ENTITY a3 SYSTEM "file:///etc/passwd">']
    else:
        lines = ['<!ENTITY a3 "&a3;">']
    head = f"<!DOCTYPE scene [{''.join(lines)}]>"
    return (head + text.replace('value="', 'value="&a3;', 1)).encode()


def _defaults(text: str, rng: Random) -> bytes:
    """Parameters that stand for more and more of others."""
    names = ["a" * n for n in range(1, 13)]
    lines = ['<default name="a" value="1111111111"/>']
    lines += [
        f'<default name="{name}" value="{f"${less}" * 10}"/>'
        for less, name in zip(names, names[1:], strict=False)
    ]
    used = text.replace("$roughness", f"${names[-1]}").replace("light.spd", f"${names[-1]}")
    if rng.random() < 0.5:
        lines.reverse()
    at = used.index(">") + 1
    return (used[:at] + "".join(lines) + used[at:]).encode()


def _includes(text: str, rng: Random) -> bytes:
    """A file that includes itself, or what is no file."""
    name = rng.choice(("scene.xml", "part.xml", "/dev/zero", "/dev/stdin", ".", "", "none.xml"))
    line = f'<include filename="{name}"/>' * rng.choice((1, 2, 50))
    return text.replace("</scene>", line + "</scene>").encode()


def _many(text: str, rng: Random) -> bytes:
    """A great many of one thing."""
    what = rng.choice(('<bsdf type="diffuse"/>', '<float name="x" value="1"/>', "<!-- -->", " "))
    count = rng.choice((100, 20_000))
    return text.replace("</scene>", what * count + "</scene>").encode()


_WAYS: tuple[Callable[[str, Random], bytes], ...] = (
    *(_bytes, _bytes, _elements, _elements, _elements, _elements),
    *(_deep, _entities, _defaults, _includes, _many),
)
