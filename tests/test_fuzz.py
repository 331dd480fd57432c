"""Hostile input: a little of what ``harness fuzz`` does, and that it finds what goes wrong."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import pytest
import yaml

from harness.cli.main import main
from harness.core.plain import DEPTH, VALUES, check_plain
from harness.core.protocol.errors import InputError
from harness.core.yamlfile import BYTES, parse_yaml, read_yaml
from harness.fuzz import mutations, run
from harness.fuzz.attempt import ACCEPTED, REFUSED, outcome
from harness.fuzz.checkpoints import Checkpoints
from harness.fuzz.scenes import Scenes
from harness.fuzz.stores import Stores
from harness.fuzz.suites import Suites
from harness.fuzz.whole_files import written
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.suite.load import from_data, load
from harness.suite.plan import make_plan
from tests import fakes
from tests.fuzz_planted import WAYS


@pytest.mark.parametrize(
    ("kind", "count"), [(Suites, 25), (Stores, 8), (Checkpoints, 25), (Scenes, 25)]
)
def test_a_few_of_each(kind, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)  # and back, wherever it goes
    folder = tmp_path / "fuzz"
    folder.mkdir()
    fuzz = kind(folder)
    found = set()
    for seed in range(count):
        found.add(outcome(fuzz, seed)[0])
        if (folder / "results").exists():
            (folder / "results").rename(folder / f"results-{seed}")
    assert found == {ACCEPTED, REFUSED}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "count"),
    [("suites", 2000), ("stores", 300), ("checkpoints", 300), ("scenes", 300)],
)
def test_many_of_each(kind: str, count: int):
    found = run.run(kind, count, seed=10**6)
    assert not found.wrong, found.wrong
    assert found.counts.total() == count


def test_what_goes_wrong_is_found_and_the_rest_goes_on(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(run, "PATIENCE", 1.0)
    monkeypatch.setattr(run, "ASLEEP", 3.0)
    monkeypatch.setattr(run, "_GLANCE", 0.1)
    found = run.run("tests.fuzz_planted:Planted", len(WAYS))
    said = {WAYS[seed]: text.strip().splitlines()[-1] for seed, text in found.wrong.items()}
    assert dict(found.counts) == {"accepted": 1, "refused": 1, "wrong": len(WAYS) - 2}
    assert said["traceback"] == "KeyError: 'planted'"
    assert said["taken for another"].endswith("Wrong: planted")
    assert said["hang"].startswith("no answer") and said["work"].startswith("no answer")
    assert said["end"] == "the process ended with status 0" and "MemoryError" in said["memory"]


def test_the_command(capsys: pytest.CaptureFixture[str]):
    assert main(["fuzz", "suits"]) == 2
    assert "did you mean 'suites'" in capsys.readouterr().err


def test_spoiled_data_is_the_same_for_a_seed():
    data = yaml.safe_load("{a: [1, {b: c}], d: e}")
    one, other = (json.dumps(mutations.spoiled(data, Random(5))) for _ in range(2))
    assert one == other and data == {"a": [1, {"b": "c"}], "d": "e"}
    assert len({mutations.damaged(bytes(100), Random(seed)) for seed in range(40)}) > 20


def bomb(levels: int) -> str:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, levels)]
    return "\n".join(lines)


REFUSED_YAML = {
    "alias bomb": (bomb(12), f"stands for more than {VALUES:,} values"),
    "merge bomb": (
        "a0: &a0 {k: 1}\n"
        + "\n".join(
            f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 10)}]}}" for i in range(1, 12)
        ),
        "a mapping of more than",
    ),
    "within itself": ("a: &a\n  - *a", f"more than {DEPTH} deep"),
    "deep": (f"a: {'[' * 5000}{']' * 5000}", f"more than {DEPTH} deep"),
    "a date": ("a: 2001-01-01", "a: expected a text, a number"),
    "no date": ("a: 2001-99-99", "a value cannot be read"),
    "binary": ("a: !!binary aGFsbG8=", "got a bytes"),
    "digits": (f"a: {'9' * 5000}", "a value cannot be read"),
    "a large number": ("a: [1, 99999999999999999999]", "a[1]: expected a whole number of 64 bits"),
    "nan": ("a: {b: .nan}", "a.b: expected a number, got nan"),
    "a control character": ('a: "\\e[31m"', "holds the character \\x1b"),
    "a surrogate": ('a: "\\ud800"', "holds the character \\ud800"),
    "a key that is none": ("on: off", "expected a text as key, got True"),
    "a long text": (f"a: {'x' * 30000}", "a text of 30,000 characters"),
}


@pytest.mark.parametrize("name", REFUSED_YAML)
def test_yaml_that_is_refused(name: str):
    text, said = REFUSED_YAML[name]
    with pytest.raises(InputError) as error:
        parse_yaml(text, "x.yaml")
    assert str(error.value).startswith("x.yaml") and said in str(error.value)


def test_aliases_of_a_sane_size_are_taken():
    found = parse_yaml(bomb(4), "x.yaml")
    assert len(found["a3"]) == 10 and found["a3"][0][9][9] == [1] * 10
    check_plain({"a": (1, 2.5, "x", None, True, [{}])}, "x")


def test_a_file_that_is_too_large_or_no_text(tmp_path: Path):
    path = tmp_path / "x.yaml"
    path.write_text("a: 1\n" + "#" * BYTES)
    with pytest.raises(InputError, match="more than 262,144 bytes"):
        read_yaml(path, "a suite")
    path.write_bytes(b"a: \xff")
    with pytest.raises(InputError, match="not a text file"):
        read_yaml(path, "a suite")


def test_sizes_that_no_machine_has_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    fakes.install(monkeypatch.setattr)
    for change, said in (
        ({"budget": {"conditions": 10**11}}, "budget.conditions"),
        ({"budget": {"conditions": -1}}, "budget.conditions"),
        ({"resolution": 10**6}, "resolution"),
        ({"seeds": [-1]}, "seeds[0]"),
        ({"seeds": [2**40]}, "seeds[0]"),
        ({"title": "\x1b[31m"}, "title: holds the character"),
        ({"methods": [{"name": "cosine", "label": "a" * 300}]}, "methods[0].label"),
        ({"seeds": list(range(30_000))}, "asks for"),
        ({"tuned": "a" * 300}, "File name too long"),
    ):
        path = fakes.suite(tmp_path, **change)
        with pytest.raises(InputError) as error:
            make_plan(load(path))
        assert said in str(error.value)
    with pytest.raises(InputError, match="^suite 'x': a key: holds the character"):
        from_data({"name": "x", "seeds\x1b": 1})


@pytest.mark.parametrize(
    ("measure", "setting", "value"),
    [
        ("pdf", "conditions", 10**11), ("pdf", "samples", 0), ("pdf", "resolution", -3),
        ("equal-spp", "spp", 0), ("equal-spp", "max_seconds", -1.0),
        ("equal-time", "deadline", 0.0), ("importance-maps", "resolutions", [16, 10**6]),
        ("convergence", "levels", 1000),
    ],
)  # fmt: skip
def test_settings_out_of_bounds_are_refused(measure: str, setting: str, value: object):
    with pytest.raises(InputError, match=f"^{setting}: expected a number from .* to .*{measure}"):
        measures.settings(measure, {setting: value})


def test_the_files_that_are_spoiled_are_good_ones(tmp_path: Path):
    found = written(tmp_path)
    kinds = {"a.safetensors": "neural", "a.ckpt": "neural", "a_b1.npy": "nbrdf", "a.h5": "nbrdf",
             "a.bsdf": "measured", "a.btf": "btf"}  # fmt: skip
    for name in found.keys() & kinds.keys():
        spec = {"name": "x", "type": kinds[name], "file": str(tmp_path / name)}
        materials.make_tested(spec)
