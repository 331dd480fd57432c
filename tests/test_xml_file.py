"""XML that would end Mitsuba's parser, and the process, is refused before it is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.core.protocol.errors import InputError
from harness.mitsuba_runtime import variant, xml_file
from harness.mitsuba_runtime.xml_file import BYTES, DEPTH, NAME, checked
from harness.suite.load import load
from harness.suite.plan import make_plan


def nested(depth: int) -> str:
    """So many elements in one another, the root among them."""
    inner = depth - 1
    return f'<scene version="3.0.0">{"<bsdf>" * inner}{"</bsdf>" * inner}</scene>'


BOMB = (
    '<!DOCTYPE scene [<!ENTITY a0 "aaaaaaaaaa">'
    + "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10))
    + ']><scene version="3.0.0"><x>&a9;</x></scene>'
)


def default(length: int) -> str:
    """A parameter that stands for ten of the one before it."""
    value = 10 * ("$" + "a" * (length - 1))
    return f'<default name="{"a" * length}" value="{value}"/>'


PARAMETERS = (
    '<scene version="3.0.0"><default name="a" value="1111111111"/>'
    + "".join(map(default, range(2, 13)))
    + '<bsdf id="$aaaaaaaaaaaa"/></scene>'
)
REFUSED = {
    "deep": (nested(DEPTH + 1), f"expected at most {DEPTH} elements in one another"),
    "very deep": (nested(100_000), f"expected at most {DEPTH} elements in one another"),
    "entities": (BOMB, "is not XML: .*amplification"),
    "cut off": (nested(5)[:-4], "is not XML"),
    "an unknown encoding": ('<?xml version="1.0" encoding="x"?>' + nested(2), "is not XML"),
    "parameters": (PARAMETERS, "'.*': expected at most 65,536 characters"),
    "a parameter for itself": (
        '<scene version="3.0.0"><default name="a" value="$a$a"/></scene>',
        "'.*': expected at most 65,536 characters",
    ),
    "a long name": (
        f'<scene version="3.0.0"><string value="{"a" * (NAME + 1)}"/></scene>',
        f"<string>: expected a text of at most {NAME} bytes",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str, tmp_path: Path) -> None:
    text, said = REFUSED[name]
    file = tmp_path / "scene.xml"
    file.write_text(text)
    with pytest.raises(InputError, match=f"scene.xml:? {said}") as error:
        checked({"file": str(file), "replace_bsdf": "x"})
    assert "\n" not in str(error.value)


def test_what_is_taken(tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    known = '<scene version="3"><default name="a" value="$b/x"/><x y="$a$c" z="$"/></scene>'
    for text in (nested(DEPTH), "\ufeff" + nested(2), "# no XML at all", "", known):
        file.write_text(text)
        spec = {"file": str(file), "replace_bsdf": {"x": {"file": str(tmp_path)}}}
        assert checked(spec) is spec
    assert checked("studio-sphere") == "studio-sphere"
    checked({"file": "a" * 5000})
    checked({"file": "a\0b"})


def test_a_large_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xml_file, "BYTES", 100)
    file = tmp_path / "scene.xml"
    file.write_text(nested(50))
    with pytest.raises(InputError, match="at most 100 bytes of XML"):
        checked({"file": str(file)})
    assert BYTES > 2**20


@pytest.mark.parametrize("name", ["deep.xml", "$part"])
def test_files_that_are_included_are_looked_at(name: str, tmp_path: Path) -> None:
    (tmp_path / "deep.xml").write_text(nested(DEPTH + 1))
    (tmp_path / "same.xml").write_text('<scene><include filename="same.xml"/></scene>')
    lines = (
        '<scene version="3.0.0"><default name="part" value="deep.xml"/>'
        f'<include filename="same.xml"/><include filename="{name}"/></scene>'
    )
    (tmp_path / "scene.xml").write_text(lines)
    with pytest.raises(InputError, match="deep.xml: expected at most"):
        checked({"name": "x", "replace_bsdf": {"a": {"file": str(tmp_path / "scene.xml")}}})


@pytest.mark.parametrize("tag", ["include", "spectrum"])
def test_a_device_is_no_file(tag: str, tmp_path: Path) -> None:
    """Its end never comes."""
    file = tmp_path / "scene.xml"
    file.write_text(f'<scene version="3.0.0"><{tag} name="x" filename="/dev/zero"/></scene>')
    with pytest.raises(InputError, match="expected the name of a file, got '/dev/zero'"):
        checked({"file": str(file)})


def test_a_spectrum_is_text(tmp_path: Path) -> None:
    (tmp_path / "light.spd").write_bytes(b"400 1\n700 \xc9\n")
    file = tmp_path / "scene.xml"
    file.write_text('<scene version="3.0.0"><spectrum name="x" filename="light.spd"/></scene>')
    with pytest.raises(InputError, match="light.spd: not a text file"):
        checked({"file": str(file)})


def test_a_suite_with_such_a_scene_is_refused(tmp_path: Path) -> None:
    """The process goes on: Mitsuba's parser has not seen it."""
    variant.use("cpu")
    (tmp_path / "deep.xml").write_text(nested(20_000))
    (tmp_path / "suite.yaml").write_text(
        "name: deep\nmaterials: [suede]\nmethods: [cosine]\nmeasures: [equal-spp]\n"
        "scenes: [{name: deep, file: deep.xml, replace_bsdf: x}]\n"
    )
    with pytest.raises(InputError, match=r"suite.yaml: scenes\[0\]: .*deep.xml: expected at most"):
        make_plan(load(tmp_path / "suite.yaml"))
