"""What is said of stored numbers, and digests of the files that specifications name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from harness.core.paths import ROOT
from harness.core.protocol.errors import InputError
from harness.identity.named_files import digest_of, named_in, replaced
from harness.identity.verdict import (
    ADAPTER,
    FIT,
    MATERIAL,
    PLACES,
    VERSIONS,
    changed_units,
    judge,
)

STORED = {ADAPTER: "1", MATERIAL: "2", FIT: "3", VERSIONS: "4"}


def test_the_same_digests_are_valid():
    verdict = judge(STORED, dict(STORED))
    assert (verdict.state, verdict.stands, verdict.sentence) == ("valid", True, "valid")


def test_another_digest_is_stale_and_says_what_changed():
    old, new = {"a.b:C.f": "1", "a.b:g": "2"}, {"a.b:C.f": "9", "a.b:g": "2"}
    verdict = judge(STORED, {**STORED, MATERIAL: "5"}, details=lambda *_: changed_units(old, new))
    assert not verdict.stands and verdict.changed == (MATERIAL,)
    assert verdict.sentence == "stale: the material's evaluator changed (a/b.py: C.f)"


def test_a_probe_lets_changed_code_stand_and_nothing_else():
    asked = []

    def agrees(part: str, old: str, new: str) -> bool:
        asked.append((part, old, new))
        return True

    verdict = judge(STORED, {**STORED, MATERIAL: "5"}, same=agrees)
    assert verdict.state == "equivalent" and verdict.stands
    assert verdict.sentence == "valid: the material's evaluator changed; the numbers did not"
    assert asked == [(MATERIAL, "2", "5")]
    assert judge(STORED, {**STORED, FIT: "5"}, same=agrees).state == "stale"
    assert judge(STORED, {**STORED, VERSIONS: "5"}, same=agrees).changed == (VERSIONS,)
    both = judge(STORED, {**STORED, MATERIAL: "5", VERSIONS: "5"}, same=agrees)
    assert both.changed == (VERSIONS,), "the part that voids it is named"


def test_a_part_that_is_new_or_gone_is_stale():
    assert (
        "not known what the method's training was"
        in judge(STORED, {**STORED, "training": "1"}, same=lambda *_: True).sentence
    )
    less = {part: STORED[part] for part in (ADAPTER, MATERIAL, VERSIONS)}
    assert judge(STORED, less).changed == (FIT,)


def test_a_moved_unit_is_no_changed_unit():
    assert changed_units({"a.b:f": "1"}, {"c.d:f": "1"}) == []
    assert changed_units({"a.b:f": "1"}, {"a.b:f": "1", "a.b:g": "2"}) == ["a/b.py: g"]
    assert changed_units({"weights.pt": "1"}, {"weights.pt": "2"}) == ["weights.pt"]


# --- named files ---------------------------------------------------------------------------


def test_files_count_by_content_and_not_by_name(tmp_path):
    (tmp_path / "a.txt").write_text("one")
    (tmp_path / "b.txt").write_text("one")
    first, second = digest_of([tmp_path / "a.txt"]), digest_of([tmp_path / "b.txt"])
    assert first.digest == second.digest and list(first.files) == ["a.txt"]
    (tmp_path / "a.txt").write_text("two")
    assert digest_of([tmp_path / "a.txt"]).digest != first.digest
    with pytest.raises(InputError, match=r"no\.txt"):
        digest_of([tmp_path / "no.txt"])


def scene(folder: Path) -> list[Path]:
    """A scene that includes another, which names a texture and a light's spectrum."""
    folder.mkdir()
    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><default name="part" value="inner"/>'
        '<include filename="$part.xml"/></scene>'
    )
    (folder / "inner.xml").write_text(
        '<scene version="3.0.0"><texture><string name="filename" value="wood.png"/></texture>'
        '<spectrum name="radiance" filename="lamp.spd"/></scene>'
    )
    (folder / "wood.png").write_bytes(b"wood")
    (folder / "lamp.spd").write_text("400 1\n700 1\n")
    return [folder / name for name in ("scene.xml", "inner.xml", "wood.png", "lamp.spd")]


@pytest.mark.parametrize(
    ("name", "old", "new", "counts"),
    [
        ("scene.xml", "<include", "<!-- why -->\n  <include", False),
        ("inner.xml", "<texture>", "<texture >\n", False),
        ("inner.xml", 'version="3.0.0"', 'version="3.0.1"', True),
        ("wood.png", "wood", "Wood", True),
        ("lamp.spd", "700 1", "700 1.001", True),
    ],
)
def test_scene_files_count_without_comments_and_layout(name, old, new, counts, tmp_path):
    files = scene(tmp_path / "s")
    before = digest_of(files).digest
    file = tmp_path / "s" / name
    assert file.read_text().count(old) == 1
    file.write_text(file.read_text().replace(old, new))
    assert (digest_of(files).digest != before) is counts


def test_a_renamed_texture_is_the_same_scene(tmp_path):
    files = scene(tmp_path / "s")
    before = digest_of(files).digest
    (tmp_path / "s" / "wood.png").rename(tmp_path / "s" / "oak.png")
    inner = tmp_path / "s" / "inner.xml"
    inner.write_text(inner.read_text().replace("wood.png", "oak.png"))
    assert digest_of([*files[:2], tmp_path / "s" / "oak.png", files[3]]).digest == before


def test_files_in_parameters_are_found(tmp_path):
    (tmp_path / "weights.pt").write_bytes(b"w")
    (tmp_path / "base").mkdir()
    (tmp_path / "base" / "maps-1.bin").write_bytes(b"m")
    params = {"width": 32, "weights": "weights.pt", "more": ["./base", "none.pt"], "loss": "kl"}
    found = {path.name for path in named_in(params, tmp_path)}
    assert found == {"weights.pt", "maps-1.bin"}
    before = replaced(params, tmp_path)
    assert before["loss"] == "kl" and before["width"] == 32 and before["weights"] != "weights.pt"
    (tmp_path / "base" / "maps-1.bin").write_bytes(b"n")
    after = replaced(params, tmp_path)
    assert after["more"][0] != before["more"][0] and after["weights"] == before["weights"]
    assert list(named_in("\0.x" + "a" * 5000, tmp_path)) == []


def test_a_part_that_differs_in_where_files_are_alone_stands():
    """And no other: one unit more that is not such a place is asked about."""
    place = sorted(PLACES)[0]
    for changed, state in (([place], "equivalent"), ([place, "a.py: f"], "stale"), ([], "stale")):
        found = judge({"measure": "1"}, {"measure": "2"}, None, lambda *_, c=changed: c)
        assert found.state == state, changed


def test_those_places_are_units():
    """A name that is gone would hide nothing, and say so."""
    for place in PLACES:
        file, _, name = place.partition(": ")
        if name not in ("METHODS", "ROOT") or "paths" in file:
            text = (ROOT / file).read_text("utf-8")
            assert re.search(rf"^(def )?{name}\b|, {name} =", text, re.MULTILINE), place
