"""Edits of a copy of the tree: those that change a number are noticed, others void nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from harness.identity import ours
from harness.mitsuba_runtime import variant
from harness.suite import source_parts
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


def _files(edit: Edit) -> set[str]:
    return {edit.file, (edit.moved or (edit.file,))[0]}


def _all_files(edits: list[Edit]) -> set[str]:
    return set().union(*map(_files, edits))


@pytest.mark.parametrize("edit", [*CHANGING, *PROBED], ids=told)
def test_an_edit_that_may_change_a_number_is_noticed(edit, tree, before):
    with edited(tree, edit):
        assert changed(before, tree, [edit.trial])


def test_edits_that_change_no_number_void_no_trial(tree, before):
    names = list(identity_trials.TRIALS)
    left = list(HARMLESS)
    while left:
        # As many at once as meet in no file, for each look at all trials takes its time.
        batch = [e for k, e in enumerate(left) if not _files(e) & _all_files(left[:k])]
        left = [edit for edit in left if edit not in batch]
        with ExitStack() as stack:
            for edit in batch:
                stack.enter_context(edited(tree, edit))
                compile((tree / edit.file).read_text(), edit.file, "exec")
            found = changed(before, tree, names)
        assert found == [], f"by one of {', '.join(map(told, batch))}"


@pytest.mark.slow
@pytest.mark.parametrize("edit", HARMLESS, ids=told)
def test_an_edit_that_changes_no_number_is_not_noticed(edit, tree, before):
    with edited(tree, edit):
        assert changed(before, tree, list(identity_trials.TRIALS)) == []


def test_what_is_named_in_tables_of_entries_exists():
    tree = ours.digests(cached=False).tree
    for entry in (*ours.TABLES, *ours.BY_NAME, *source_parts.EVERY_TRIAL, *source_parts.SHARED_RUN):
        assert tree.entry(entry)


def test_there_are_as_many_as_promised():
    assert len(CHANGING) >= 40
    assert len(HARMLESS) + len(PROBED) >= 20
