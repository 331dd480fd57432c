"""Output of commands that had nothing to do: given again where nothing changed, and only there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from harness.cli import run as run_verb
from harness.cli.main import main
from harness.runner import answer_cache
from harness.runner.answer_cache import AnswerCache

SUITE = {
    "name": "tiny",
    "title": "One number, of U.S.A./x.yaml",
    "materials": ["disney"],
    "methods": ["cosine", {"name": "histogram", "label": "histogram (loss=kl)"}],
    "measures": [{"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8}],
    "report": {"tables": ["pdf"], "figures": []},
}
ANSWER = {"text": "said\n"}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Answers are kept, in a cache of the test; a package of two files stands for ours."""
    monkeypatch.setattr(answer_cache, "enabled", True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "root" / "harness" / "inside").mkdir(parents=True)
    (tmp_path / "root" / "methods").mkdir()
    (tmp_path / "root" / "harness" / "_methods").symlink_to(tmp_path / "root" / "methods")
    for name in ("harness/inside/a.py", "methods/b.py"):
        (tmp_path / "root" / name).write_text("x = 1\n")
    monkeypatch.setattr(answer_cache, "ROOT", tmp_path / "root")
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(SUITE))
    (tmp_path / "out" / "files").mkdir(parents=True)
    (tmp_path / "out" / "results.sqlite").write_text("stored")
    (tmp_path / "out" / "files" / "0.exr").write_text("picture")
    return tmp_path


def of(folder: Path, **command: object) -> AnswerCache:
    return AnswerCache(command, str(folder / "tiny.yaml"), folder / "out")


def test_an_answer_is_given_again(here: Path):
    assert of(here).find() is None
    of(here).keep(ANSWER)
    assert of(here).find() == ANSWER
    (here / "out" / "report").mkdir()
    (here / "out" / "report" / "index.html").write_text("made of what is stored")
    (here / "root" / "harness" / "__pycache__").mkdir()
    (here / "root" / "harness" / "__pycache__" / "a.pyc").write_text("made of the source")
    assert of(here).find() == ANSWER


CHANGES: dict[str, Callable[[Path, pytest.MonkeyPatch], object]] = {
    "source": lambda p, _: (p / "root" / "harness" / "inside" / "a.py").write_text("x = 2\n"),
    "adapter": lambda p, _: (p / "root" / "methods" / "b.py").write_text("x = 2\n"),
    "new-file": lambda p, _: (p / "root" / "harness" / "c.py").write_text(""),
    "suite": lambda p, _: (p / "tiny.yaml").write_text(yaml.safe_dump(SUITE | {"seeds": [0, 1]})),
    "stored": lambda p, _: (p / "out" / "results.sqlite").write_text("stor3d"),
    "picture": lambda p, _: (p / "out" / "files" / "0.exr").write_text("another"),
    "lost": lambda p, _: (p / "out" / "files" / "0.exr").unlink(),
    "environment": lambda _, patch: patch.setenv("BSDF_HARNESS_KERNELS", "off"),
    "folder": lambda p, patch: patch.chdir(p),
    "installed": lambda p, patch: (
        (p / "site" / "x-2.0.dist-info").mkdir(parents=True),
        patch.syspath_prepend(p / "site"),
    ),
    "compiler": lambda p, patch: patch.setattr(
        answer_cache, "compiler", lambda: str(p / "tiny.yaml")
    ),
    "kernels": lambda p, _: (p / "cache" / "bsdf-sampling-harness" / "k.so").write_text("k"),
    "machine": lambda _, patch: patch.setattr(
        answer_cache, "machine", SimpleNamespace(identity=lambda: {"cpu": "another"})
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_after_a_change_it_is_not(here: Path, monkeypatch: pytest.MonkeyPatch, change: str):
    of(here).keep(ANSWER)
    assert of(here).find() == ANSWER
    CHANGES[change](here, monkeypatch)
    assert of(here).find() is None


def test_another_command_has_another_answer(here: Path):
    of(here, only="method=cosine").keep(ANSWER)
    assert of(here, only="method=cosine").find() == ANSWER
    assert of(here).find() is None
    assert AnswerCache({"only": "method=cosine"}, str(here / "tiny.yaml"), here).find() is None


@pytest.mark.parametrize(
    "names",
    [
        {"methods": ["adapters.py:Good"]},
        {"methods": [{"name": "cosine", "params": {"weights": "w.bin"}}]},
        {"methods": [{"name": "cosine", "params": {"title": "w.bin"}}]},
        {"methods": [{"name": "cosine", "params": {"x": ["a/b"]}}]},
        {"materials": [{"name": "paint", "type": "measured", "file": "paint"}]},
        {"materials": [{"type": "measured", "folder": "many"}]},
        {"scenes": [{"name": "outside", "scene": "draped-cloth", "environment": "meadow"}]},
        {"tuned": "found"},
    ],
    ids=str,
)
def test_a_suite_that_may_name_a_file_is_planned_anew(here: Path, names: dict[str, object]):
    (here / "tiny.yaml").write_text(yaml.safe_dump(SUITE | names))
    of(here).keep(ANSWER)
    assert of(here).find() is None


def test_methods_of_another_package_are_not_looked_at(here: Path, monkeypatch: pytest.MonkeyPatch):
    of(here).keep(ANSWER)
    other = SimpleNamespace(value="theirs.methods:Fast")
    monkeypatch.setattr(answer_cache, "entry_points", lambda group: [other])
    assert of(here).find() is None


def test_what_was_edited_meanwhile_is_not_kept(here: Path):
    begun = of(here)
    CHANGES["adapter"](here, pytest.MonkeyPatch())
    begun.keep(ANSWER)
    (here / "root" / "methods" / "b.py").write_text("x = 1\n")
    assert of(here).find() is None


def test_a_cache_that_cannot_be_written_or_read(here: Path):
    (here / "cache").write_text("a file")
    of(here).keep(ANSWER)
    assert of(here).find() is None


def test_few_answers_are_kept(here: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(answer_cache, "_MOST", 3)
    for number in range(5):
        of(here, number=number).keep(ANSWER)
    assert len([*(here / "cache").rglob("answers/*.json")]) == 3


def test_commands_are_answered(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """A run, a list of trials and a validation: planned once, and anew after a change."""
    suite, out = str(here / "tiny.yaml"), here / "new"
    (here / "tiny.yaml").write_text(yaml.safe_dump(SUITE | {"methods": ["cosine"]}))
    plans = []
    usual = run_verb.planned
    monkeypatch.setattr(run_verb, "planned", lambda *a, **k: plans.append(1) or usual(*a, **k))

    def printed(*more: str) -> str:
        assert main(["run", suite, "--out", str(out), *more]) == 0
        return capsys.readouterr().out

    assert (
        "2 to do" in printed("--dry-run") and "2 to do" in printed("--dry-run") and len(plans) == 1
    )
    printed()
    second, third = printed(), printed()
    assert len(plans) == 3 and "2 trials, all stored" in second
    assert second == third and "pdf" in third
    (here / "root" / "methods" / "b.py").write_text("x = 3\n")
    assert printed() == second and len(plans) == 4
    assert main(["validate", suite]) == 0
    once = capsys.readouterr().out
    monkeypatch.setattr("harness.runner.preflight.ready", lambda device: 1 / 0)
    assert main(["validate", suite]) == 0
    assert capsys.readouterr().out == once != ""
