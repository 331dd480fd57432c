"""Every command that writes: what is there already and is not its own stays byte for byte."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from harness.cli.main import main
from harness.core.protocol.errors import InputError
from harness.materials.neural import storage
from harness.materials.neural.files import shipped as neural
from harness.microgeometry.__main__ import main as microgeometry
from harness.runner import shipped
from harness.store.publish import publish
from harness.training.training import Training
from tests import fakes, stores

MINE = b"%PDF of my thesis\n\xff\x00"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    fakes.install(monkeypatch.setattr)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def content(folder: Path) -> dict[str, bytes | None]:
    """All that is in a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that a command is refused with; nothing here changes by it."""
    here = Path()
    before = content(here)
    status = main(arguments)
    error = capsys.readouterr().err
    assert status == 2 and error.startswith("error: ") and error.count("\n") == 1, error
    assert content(here) == before
    return error


FOLDERS = {
    "run": ["run", "suite.yaml", "--out"],
    "effects": ["effects", "suite.yaml", "--out"],
    "fit results": ["fit", "suite.yaml", "--results"],
    "fit": ["fit", "suite.yaml", "--out"],
    "bake": ["bake", "--material", "suede", "--slices", "1", "--out"],
}
FILES = {
    "tune": (["tune", "suite.yaml", "--trials", "1", "--seconds", "0.1", "--out"], "a.yaml"),
    "train": (["material", "train", "leather", "--out"], "a.safetensors"),
    "preview": (["material", "preview", "leather", "--out"], "a.png"),
}


@pytest.fixture
def suite(here: Path) -> Path:
    fakes.suite(here)
    return here / "suite.yaml"


@pytest.mark.parametrize("command", FOLDERS)
@pytest.mark.parametrize(
    "name", ["thesis.pdf", "report", "suite.yaml", "files", ".tmp-1", "a.old-1"]
)
def test_a_folder_that_holds_something_is_not_written_to(
    command: str, name: str, suite: Path, capsys: pytest.CaptureFixture[str]
):
    folder = Path("mine")
    folder.mkdir()
    (folder / name).write_bytes(MINE)
    error = refused([*FOLDERS[command], "mine"], capsys)
    assert "mine: holds other things than " in error and name in error


@pytest.mark.parametrize("command", FOLDERS)
@pytest.mark.parametrize("out", ["", ".", "./"])
def test_the_current_folder_is_not_a_folder_for_results(
    command: str, out: str, suite: Path, capsys: pytest.CaptureFixture[str]
):
    Path("thesis.pdf").write_bytes(MINE)
    assert "expected a folder of its own" in refused([*FOLDERS[command], out], capsys)


@pytest.mark.parametrize("command", FILES)
def test_a_file_of_somebody_else_is_not_replaced(
    command: str, suite: Path, capsys: pytest.CaptureFixture[str]
):
    arguments, name = FILES[command]
    Path(name).write_bytes(MINE)
    assert f"{name}: is there already and is not " in refused([*arguments, name], capsys)
    Path(name).unlink()
    Path(name).symlink_to("nowhere")
    assert f"{name}: is there already and is not " in refused([*arguments, name], capsys)
    assert Path(name).is_symlink()


@pytest.mark.parametrize("command", FILES)
def test_no_file_is_no_place_to_write(
    command: str, suite: Path, capsys: pytest.CaptureFixture[str]
):
    arguments, name = FILES[command]
    assert "expected a " in refused([*arguments, ""], capsys)
    Path("taken").write_bytes(MINE)
    assert "cannot be written" in refused([*arguments, f"taken/{name}"], capsys)


def test_its_own_files_are_replaced(suite: Path):
    arguments, name = FILES["tune"]
    for _ in range(2):
        assert main([*arguments, name]) == 0
    text = Path(name).read_text()
    assert text.startswith("# Written by: harness tune")


def test_fits_go_beside_fits_and_nothing_else_is_replaced(
    suite: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = ["fit", "suite.yaml", "--results", "out", "--out", "fits"]
    for _ in range(2):
        assert main(arguments) == 0
    made = sorted(Path("fits").glob("*.safetensors"))
    assert made and (Path("fits") / shipped.CHECKSUMS).is_file()
    made[0].write_bytes(MINE)
    capsys.readouterr()
    assert "is not a fitted sampler" in refused(arguments, capsys)


def test_a_training_under_way_is_not_replaced_by_mistake(
    here: Path, capsys: pytest.CaptureFixture[str]
):
    (here / "mine.train").write_bytes(MINE)
    said = refused(["material", "train", "leather", "--out", "mine.safetensors"], capsys)
    assert "mine.train: is there already and is not a training under way" in said


def test_a_material_of_ours_is_recognised():
    from harness.cli.material import _is_ours, _is_training

    file = neural()["leather"]
    assert _is_ours(file) and storage.metadata(file)
    torch.save({"labels": {}}, "x.train")
    assert _is_training(Path("x.train")) and Training.save


def test_the_contact_sheet_replaces_no_picture(here: Path, capsys: pytest.CaptureFixture[str]):
    (here / "sheet.png").write_bytes(MINE)
    with pytest.raises(SystemExit) as end:
        microgeometry(["sheet", "sheet.png"])
    assert end.value.code == 2 and "is not a picture of this command" in capsys.readouterr().err
    assert (here / "sheet.png").read_bytes() == MINE


def test_new_replaces_nothing(here: Path, capsys: pytest.CaptureFixture[str]):
    (here / "methods").mkdir()
    (here / "methods" / "mine.py").write_bytes(MINE)
    assert "exists already" in refused(["new", "method", "mine"], capsys)


def test_a_report_goes_to_a_folder_of_its_own(here: Path, capsys: pytest.CaptureFixture[str]):
    folder = stores.make(here / "out")
    (folder / "report").mkdir()
    (folder / "report" / "index.html").write_bytes(MINE)
    assert "report: holds other things than a report (index.html)" in refused(
        ["report", str(folder)], capsys
    )
    (folder / "report" / "index.html").unlink()
    assert main(["report", str(folder)]) == 0
    (folder / "report" / "notes.txt").write_bytes(MINE)
    outside = here / "outside.txt"
    outside.write_bytes(MINE)
    listed = folder / "report" / "files.txt"
    listed.write_text(listed.read_text() + f"../../outside.txt\n{outside}\nnotes/..\n")
    assert main(["report", str(folder)]) == 0
    assert outside.read_bytes() == (folder / "report" / "notes.txt").read_bytes() == MINE


def test_publishing_replaces_results_and_leaves_the_rest(here: Path):
    first, target = stores.make(here / "out"), here / "published"
    (first / "suite.yaml").write_text("suite")
    beside = here / ".published-new"
    beside.mkdir()
    (beside / "thesis.pdf").write_bytes(MINE)
    assert publish(first, target) == publish(first, target) == len(stores.KEYS)
    (target / "thesis.pdf").write_bytes(MINE)
    assert publish(first, target) == len(stores.KEYS)
    assert (target / "thesis.pdf").read_bytes() == (beside / "thesis.pdf").read_bytes() == MINE
    assert sorted(p.name for p in target.iterdir()) == [
        "results.sqlite.xz", "suite.yaml", "thesis.pdf"
    ]  # fmt: skip
    other = here / "other"
    other.mkdir()
    (other / "thesis.pdf").write_bytes(MINE)
    with pytest.raises(InputError, match="holds other things than results"):
        publish(first, other)
    assert content(other) == {"thesis.pdf": MINE}


def test_a_page_replaces_only_a_page(here: Path, capsys: pytest.CaptureFixture[str]):
    one = stores.make(here / "many" / "one")
    (here / "many" / "index.html").write_bytes(MINE)
    (here / "comparison.html").write_bytes(MINE)
    compared = ["compare", "--html", str(one), str(one)]
    assert "is not a page of the harness" in refused(compared, capsys)
    assert main(["report", str(one)]) == 0
    assert "is not a page of the harness" in refused(["report", "many"], capsys)
    (here / "many" / "index.html").unlink()
    (here / "comparison.html").unlink()
    for _ in range(2):
        assert main(["report", "many"]) == main(compared) == 0


def test_merging_goes_to_a_folder_of_its_own(here: Path, capsys: pytest.CaptureFixture[str]):
    one = stores.make(here / "one")
    (one / "suite.yaml").write_text("suite")
    (here / "mine").mkdir()
    (here / "mine" / "thesis.pdf").write_bytes(MINE)
    assert "holds other things than results" in refused(
        ["merge", str(one), str(one), "--out", "mine"], capsys
    )


def test_a_database_of_maps_that_is_none(here: Path, capsys: pytest.CaptureFixture[str]):
    (here / "maps").mkdir()
    for text in ("[", "[1]", json.dumps({"format": 7})):
        (here / "maps" / "database.json").write_text(text)
        refused([*FOLDERS["bake"], "maps"], capsys)
