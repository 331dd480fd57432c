"""Finding methods: by name, by file, by entry point; and what is refused."""

from __future__ import annotations

import os
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from harness import Method
from harness.cli.main import main
from harness.core import registry
from harness.core.protocol.errors import InputError
from harness.identity.digests import Part, SourceDigest
from harness.identity.ours import digest_of_class, digests
from harness.suite import source_parts
from tests.fakes import ADAPTERS


@pytest.fixture
def adapters(tmp_path: Path) -> Path:
    file = tmp_path / "adapters.py"
    file.write_text(ADAPTERS)
    return file


def code_of(name: str) -> SourceDigest:
    """What an adapter's numbers stand on, as its files are now."""
    digests.cache_clear()
    known = digests()
    part = source_parts.method(known.tree, name)
    return known.of({"adapter": Part(part.entries, ("sample", "pdf", "fit"))})["adapter"]


def test_shipped_methods_are_found_without_import():
    names = registry.names()
    assert {"cosine", "improved-baseline", "two-lobe", "native", "tabulated"} <= set(names)
    for name in names:
        assert registry.describe(name)
        assert registry.find(name).name == name


@pytest.mark.parametrize("name", registry.names())
def test_shipped_method_loads(name: str):
    method = registry.make(name)
    assert isinstance(method, Method)
    assert method.name == name


def test_unknown_name_gets_the_nearest():
    with pytest.raises(InputError, match="unknown method 'cosin'; did you mean 'cosine'"):
        registry.make("cosin")


def test_plain_subclass_in_a_file(adapters: Path):
    method = registry.make(f"{adapters}:Good")
    assert method.name == "Good"
    assert registry.make(f"{adapters}:Named", scale=2.0).scale == 2.0
    assert registry.find(f"{adapters}:Named").name == "with-state"


def test_relative_to_the_working_folder(adapters: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(adapters.parent)
    assert registry.make("adapters.py:Good").name == "Good"


@pytest.mark.parametrize(
    ("tail", "message"),
    [
        (":Goodd", "no class 'Goodd'; did you mean 'Good'"),
        ("", "name one class"),
        (":NoMethod", "NoMethod is not a subclass of harness.Method"),
        (":NoPdf", "NoPdf does not define pdf"),
    ],
)
def test_a_class_that_is_none(adapters: Path, tail: str, message: str):
    with pytest.raises(InputError, match=message) as refused:
        registry.make(f"{adapters}{tail}")
    assert "\n" not in str(refused.value)


def test_no_such_file():
    with pytest.raises(InputError, match="no such file: nowhere/x.py"):
        registry.find("nowhere/x.py:X")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import nowhere_to_be_found\nclass A: pass", "cannot import .*ModuleNotFoundError"),
        ("import sys\nsys.exit(3)\nclass A: pass", "SystemExit: 3"),
        ("class A:\n  def", "line 2: not valid Python"),
    ],
)
def test_a_file_that_does_not_import(tmp_path: Path, text: str, message: str):
    file = tmp_path / "broken.py"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        registry.make(f"{file}:A")


def test_parameters(adapters: Path):
    with pytest.raises(InputError, match="unknown parameter 'scal'; did you mean 'scale'"):
        registry.make(f"{adapters}:Named", scal=1)
    with pytest.raises(InputError, match="unknown parameter 'x'; it takes none"):
        registry.make(f"{adapters}:Good", x=1)


def test_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    package = tmp_path / "their_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    used = ADAPTERS.replace("1 / math.pi", "VALUE / math.pi")
    (package / "samplers.py").write_text("from their_package.helper import VALUE\n" + used)
    (package / "helper.py").write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    point = EntryPoint("theirs", "their_package.samplers:Good", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    assert "theirs" in registry.names()
    assert registry.make("theirs").name == "theirs"
    before = code_of("theirs")
    assert "their_package.helper:VALUE" in before.units
    (package / "helper.py").write_text("VALUE = 22\n")
    assert code_of("theirs").digest != before.digest


def test_entry_point_to_nowhere(monkeypatch: pytest.MonkeyPatch):
    point = EntryPoint("theirs", "no_such_package.x:Y", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    with pytest.raises(InputError, match="theirs"):
        registry.make("theirs")


def test_code_follows_what_is_used_and_not_what_is_imported():
    modules = {unit.partition(":")[0] for unit in code_of("improved-baseline").units}
    assert {"harness.nets.mlp", "harness.core.protocol.disk"} <= modules
    assert not any(module.startswith("harness.measures") for module in modules)
    assert not any(unit.startswith("harness.nets") for unit in code_of("cosine").units)


def test_code_of_a_lone_file_follows_its_neighbours(adapters: Path):
    (adapters.parent / "helper.py").write_text("A = 1\n")
    adapters.write_text("from helper import A\n" + ADAPTERS.replace("1 / math.pi", "A / math.pi"))
    before = code_of(f"{adapters}:Good")
    assert str(adapters.parent) not in str(before.units)
    (adapters.parent / "helper.py").write_text("A = 234\n")
    assert code_of(f"{adapters}:Good").digest != before.digest


def test_a_lone_class_is_read_again_after_an_edit(tmp_path: Path):
    file = tmp_path / "x.py"
    file.write_text("from helper import A\n\nclass Plugin:\n    B = A\n")
    (tmp_path / "helper.py").write_text("A = 1\n")
    before = digest_of_class(file, "Plugin")
    file.write_text("from helper import A\n\nclass Plugin:\n    B = A  # as there\n")
    assert digest_of_class(file, "Plugin") == before
    (tmp_path / "helper.py").write_text("A = 1000\n")
    assert digest_of_class(file, "Plugin") != before


def test_an_edit_of_the_same_length_within_a_second_runs(
    adapters: Path, monkeypatch: pytest.MonkeyPatch
):
    """Python tells kept byte code from an edited file by its length and whole seconds."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    text = adapters.read_text()
    for nanoseconds, value in enumerate("12"):
        adapters.write_text(f"{text}\nVALUE = {value}\n")
        os.utime(adapters, ns=(10**18 + nanoseconds,) * 2)
        method = registry.make(f"{adapters}:Good")
        assert str(sys.modules[type(method).__module__].VALUE) == value


def test_a_broken_entry_point_hides_no_other(tmp_path, monkeypatch, capsys):
    """It is listed with the reason, and refused when it is asked for."""
    (tmp_path / "broken_package").mkdir()
    (tmp_path / "broken_package" / "__init__.py").write_text("raise RuntimeError('half done')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [
        EntryPoint("broken", "broken_package.samplers:Good", registry.GROUP),
        EntryPoint("gone", "no_such_package:Good", registry.GROUP),
        EntryPoint("classless", "json", registry.GROUP),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    assert main(["list", "methods"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "half done" in lines["broken"] and "cannot" in lines["broken"]
    assert all("broken: method" in lines[point.name] for point in points)
    assert registry.make("cosine").name == "cosine" and "cosine" in lines
    with pytest.raises(InputError, match="half done"):
        registry.make("broken")
