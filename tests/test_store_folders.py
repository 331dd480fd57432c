"""Folders that are not for a run to write to: refused in one line, and nothing in them touched."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from harness.cli.main import main
from harness.core.protocol.errors import InputError
from harness.store.database import FILE, FORMAT
from harness.store.lock import locked
from tests import fakes, stores


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


def content(folder: Path) -> dict[str, bytes | None]:
    """All that is in a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def newer(folder: Path) -> None:
    stores.make(folder)
    with closing(sqlite3.connect(folder / FILE)) as connection:
        connection.execute(f"PRAGMA user_version = {FORMAT + 1}")


def older(folder: Path) -> None:
    """A folder per trial, as it was before."""
    (folder / stores.KEYS[0]).mkdir(parents=True)
    (folder / stores.KEYS[0] / "trial.json").write_text("{}")
    (folder / "plan.json").write_text('{"trials": []}')


def another_program(folder: Path) -> None:
    folder.mkdir()
    with closing(sqlite3.connect(folder / FILE)) as connection, connection:
        connection.execute("CREATE TABLE photos (name TEXT)")
        connection.execute("INSERT INTO photos VALUES ('one')")


def another_program_with_a_mark(folder: Path) -> None:
    another_program(folder)
    with closing(sqlite3.connect(folder / FILE)) as connection:
        connection.execute("PRAGMA application_id = 77")


REFUSED = [
    (newer, f"results of a newer format ({FORMAT + 1}; this version writes {FORMAT})"),
    (older, "holds results of an older format, one folder a trial"),
    (another_program, "is another program's database; choose another folder"),
    (another_program_with_a_mark, "is another program's database; choose another folder"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED, ids=[make.__name__ for make, _ in REFUSED])
def test_results_of_another_kind(
    tmp_path: Path, make: Callable[[Path], None], message: str, capsys: pytest.CaptureFixture[str]
):
    suite, folder = fakes.suite(tmp_path / "suite"), tmp_path / "out"
    make(folder)
    before = content(folder)
    for arguments in (
        ["run", str(suite), "--out", str(folder)],
        ["report", str(folder)],
        ["status", str(folder)],
        ["compare", str(folder), str(folder)],
    ):
        assert main(arguments) == 2, arguments
        error = capsys.readouterr().err
        assert error.startswith(f"error: {folder}") and error.count("\n") == 1
        assert message in error, arguments
    assert content(folder) == before


@pytest.mark.parametrize("name", ["holiday.jpg", "files", "suite.yaml", ".hidden"])
def test_a_folder_with_other_things(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]):
    suite, folder = fakes.suite(tmp_path / "suite"), tmp_path / "out"
    folder.mkdir()
    (folder / name).write_text("mine")
    assert main(["run", str(suite), "--out", str(folder)]) == 2
    error = capsys.readouterr().err
    assert f"{folder}: holds other things than results ({name})" in error
    assert content(folder) == {name: b"mine"}


def test_things_that_a_user_puts_beside_results_do_not_matter(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    (folder / "notes.txt").write_text("mine")
    with locked(folder):
        pass
    assert (folder / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("", "--out: expected a folder of its own for the results"),
        (".", "--out: expected a folder of its own for the results"),
        ("taken", "taken: is a file; expected a folder for the results"),
        ("taken/below", "taken/below: cannot be made: Not a directory"),
    ],
)
def test_no_folder_at_all(
    tmp_path: Path, out: str, message: str, monkeypatch, capsys: pytest.CaptureFixture[str]
):
    suite = fakes.suite(tmp_path / "suite")
    (tmp_path / "taken").write_text("mine")
    monkeypatch.chdir(tmp_path)
    before = content(tmp_path)
    assert main(["run", str(suite), "--out", out]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert content(tmp_path) == before


def test_a_lock_that_is_a_link_is_not_followed(tmp_path: Path):
    folder, theirs = stores.make(tmp_path / "out"), tmp_path / "theirs"
    theirs.write_text("theirs")
    (folder / ".lock").unlink()
    (folder / ".lock").symlink_to(theirs)
    with pytest.raises(InputError, match="cannot be written"), locked(folder):
        pass
    assert theirs.read_text() == "theirs"


def test_an_empty_folder_is_taken(tmp_path: Path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".gitignore").write_text("*\n")
    with locked(tmp_path / "out"):
        assert (tmp_path / "out" / FILE).is_file()
