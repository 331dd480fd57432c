"""Edits of a copy of the tree: those that change a number are noticed, others void nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from harness.mitsuba_runtime import variant
from tests.planted_edits import CHANGING, HARMLESS, PROBED, Edit

variant.use("cpu")

from tests import identity_trials  # noqa: E402  (measures that render need a variant)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return identity_trials.copy_of_tree(tmp_path_factory.mktemp("tree"))


@pytest.fixture(scope="module")
def before(tree: Path) -> dict:
    return identity_trials.digests_of(tree)


@contextmanager
def edited(tree: Path, edit: Edit) -> Iterator[None]:
    file = tree / edit.file
    kept = {path: path.read_text() for path in (file, tree / (edit.moved or (edit.file,))[0])}
    assert kept[file].count(edit.old) == 1, f"{edit.file}: {edit.old!r} is not there once"
    try:
        file.write_text(kept[file].replace(edit.old, edit.new))
        if edit.moved:
            place = tree / edit.moved[0]
            place.write_text(place.read_text() + edit.moved[1])
        yield
    finally:
        for path, text in kept.items():
            path.write_text(text)


def changed(before: dict, tree: Path, names: list[str]) -> list[str]:
    after = identity_trials.digests_of(tree, names)
    return [
        f"{name}: {part}"
        for name in names
        for part, found in after[name].items()
        if found.digest != before[name][part].digest
    ]


def told(edit: Edit) -> str:
    return f"{edit.trial}:{edit.file.rpartition('/')[2]}:{' '.join(edit.old.split())[:30]}"


@pytest.mark.parametrize("edit", [*CHANGING, *PROBED], ids=told)
def test_an_edit_that_may_change_a_number_is_noticed(edit, tree, before):
    with edited(tree, edit):
        assert changed(before, tree, [edit.trial])


@pytest.mark.parametrize("edit", HARMLESS, ids=told)
def test_an_edit_that_changes_no_number_is_not(edit, tree, before):
    with edited(tree, edit):
        compile((tree / edit.file).read_text(), edit.file, "exec")
        assert changed(before, tree, list(identity_trials.TRIALS)) == []


def test_there_are_as_many_as_promised():
    assert len(CHANGING) >= 40
    assert len(HARMLESS) + len(PROBED) >= 20
