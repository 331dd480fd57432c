"""Normal forms: what counts of a source text, and what reaches what."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from harness.core.paths import ROOT
from harness.core.protocol.errors import InputError
from harness.identity.cache import Cache
from harness.identity.digests import Digests, Part, SourceDigest
from harness.identity.tree import Tree
from harness.identity.units import units_of


def form(text: str, name: str = "f") -> str:
    return units_of(text)["units"][name]["hash"]


def same(first: str, second: str, name: str = "f") -> bool:
    return form(first, name) == form(second, name)


def of(tmp_path: Path, files: dict[str, str], entries: str, **cut) -> SourceDigest:
    """Digest of what ``entries`` reach in the package ``ours`` with these files."""
    for name, text in files.items():
        path = tmp_path / "ours" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    tree = Tree({"ours": tmp_path / "ours"}, **cut)
    return Digests(tree).of({"part": Part(tuple(entries.split()))})["part"]


def names(found: SourceDigest) -> set[str]:
    return set(found.units)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("def f(x):\n    y = x + 1\n    return y", "def f(x):\n    z = (x + 1)\n\n    return z  #"),
        ('def f(x):\n    """One."""\n    return x', "def f(x):\n    return x"),
        ("def f(x: int) -> int:\n    return x", "def f(x):\n    return x"),
        ("def f(x):\n    y: int = x\n    return y", "def f(x):\n    y = x\n    return y"),
        ("def f(x):\n    return [a for a in x]", "def f(x):\n    return [b for b in x]"),
        ("def f(x):\n    return lambda a: a + x", "def f(x):\n    return lambda b: b + x"),
        ("def f(x):\n    raise ValueError(f'no {x}')", "def f(x):\n    raise ValueError('never')"),
        ("def f(x):\n    return 1e-3 * x", "def f(x):\n    return 0.001 * x"),
        ("def f(x):\n    assert x, 'a'", "def f(x):\n    assert x, 'b'"),
    ],
)
def test_what_does_not_count(first, second):
    assert same(first, second)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("import a.b\ndef f(): return a.b.c()", "from a import b\ndef f(): return b.c()"),
        ("import numpy as np\ndef f(): return np.pi", "import numpy\ndef f(): return numpy.pi"),
        ("from ours.n import h\ndef f(): return h()", "from ours import n\ndef f(): return n.h()"),
        ("from ours.n import h\ndef f(): return h()", "def f():\n  from .n import h\n  return h()"),
    ],
)  # fmt: skip
def test_how_a_name_is_imported_does_not_count(first, second, tmp_path):
    other = {"n": "def h(): return 1\n"}
    found = [of(tmp_path, {"m": text, **other}, "ours.m:f") for text in (first, second)]
    assert found[0].digest == found[1].digest


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("def f(x):\n    return x + 1", "def f(x):\n    return x + 1.0"),
        ("def f(a, b):\n    return a - b", "def f(b, a):\n    return b - a"),
        ("def f(a, b=1):\n    return a", "def f(a, b=2):\n    return a"),
        ("def f(x):\n    y, z = x\n    return y - z", "def f(x):\n    y, z = x\n    return z - y"),
        ("def f(x):\n    return g(x, k=1)", "def f(x):\n    return g(x, j=1)"),
        ("def f(x):\n    return x.mean()", "def f(x):\n    return x.median()"),
        ("def f(x):\n    raise ValueError", "def f(x):\n    raise KeyError"),
        ("def f(x):\n    return sum(x)", "def f(sum):\n    return sum(sum)"),
        ("@cache\ndef f(x):\n    return x", "def f(x):\n    return x"),
        ("def f(x):\n    return [a for a in x]", "def f(x):\n    return (a for a in x)"),
        ("def f(x):\n    a, b = x\n    return a", "def f(x):\n    a, b = x\n    return b"),
    ],
)  # fmt: skip
def test_what_counts(first, second):
    assert not same(first, second)


def test_parameters_of_private_functions_are_locals_unless_given_by_keyword():
    assert same("def _f(a):\n    return a", "def _f(b):\n    return b", "_f")
    call = "\ndef g():\n    return _f(a=1)"
    assert not same(f"def _f(a):\n    return a{call}", f"def _f(b):\n    return b{call}", "_f")


def test_only_what_is_reached_counts(tmp_path):
    files = {"m": "A = 1\nB = 2\ndef f(): return A\ndef g(): return B\n"}
    assert names(of(tmp_path, files, "ours.m:f")) == {"ours.m:f", "ours.m:A"}


def test_a_name_in_a_class_may_be_the_module_s(tmp_path):
    files = {"m": "A = 1\nB = 2\nclass C:\n    A = A\n    D = 3\n    E = D\n"}
    assert names(of(tmp_path, files, "ours.m:C")) == {"ours.m:C", "ours.m:A"}


def test_methods_are_reached_by_mention_alone(tmp_path):
    files = {
        "m": "class C:\n    def a(self): return 1\n    def b(self): return 2\n"
        "    def __len__(self): return 3\n"
        "def f(x): return C().a()\n",
        "n": "def g(x):\n    return x.b()\n",
    }
    alone = of(tmp_path, files, "ours.m:f")
    assert names(alone) == {"ours.m:f", "ours.m:C", "ours.m:C.a", "ours.m:C.__len__"}
    known = Digests(Tree({"ours": tmp_path / "ours"}))
    both = known.of({"one": Part(("ours.m:f",)), "other": Part(("ours.n:g",))})
    # Another part may call what this one has made.
    assert "ours.m:C.b" in both["one"].units
    assert both["one"].digest != alone.digest


@pytest.mark.parametrize(
    "call",
    [
        "getattr(x, 'b')",
        "getattr(x, NAME)",
        "[getattr(x, k) for k in ('b',)]",
        "getattr(x, f'b{x}')",
    ],
)
def test_methods_are_reached_by_name(call, tmp_path):
    text = f"NAME = 'b'\nclass C:\n    def b(self): return 2\ndef f(): x = C(); return {call}\n"
    assert "ours.m:C.b" in names(of(tmp_path, {"m": text}, "ours.m:f"))


def test_all_methods_count_that_something_outside_may_call(tmp_path):
    files = {
        "m": "from torch import nn\nclass B(nn.Module):\n    def forward(self, x): return x\n"
        "class C(B):\n    def hook(self): return 1\nclass D(tuple):\n    def e(self): return 1\n"
        "def f(): return C()\n",
    }
    found = names(of(tmp_path, files, "ours.m:f"))
    assert {"ours.m:B.forward", "ours.m:C.hook"} <= found
    assert "ours.m:D" not in found


def test_telling_types_apart_reaches_no_method(tmp_path):
    text = "class C:\n    def a(self): return 1\ndef f(x): return isinstance(x, C) and x.a()\n"
    assert names(of(tmp_path, {"m": text}, "ours.m:f")) == {"ours.m:f"}


def test_statements_of_imported_modules_count(tmp_path):
    files = {
        "m": "from ours import n\ndef f(): return 1\n",
        "n": "import sys\nclass K: pass\nsys.path.append('a')\n",
    }
    before = of(tmp_path, files, "ours.m:f")
    assert "ours.n:<0>" in before.units
    files["n"] = files["n"].replace("'a'", "'b'")
    assert of(tmp_path, files, "ours.m:f").digest != before.digest


def test_two_helpers_of_one_name_are_not_mixed_up(tmp_path):
    files = {
        "a": "def scale(x): return 2 * x\n",
        "b": "def scale(x): return 3 * x\n",
        "m": "from ours.a import scale\nfrom ours import b\ndef f(x): return scale(x)\n"
        "def g(x): return b.scale(x) + f(x)\n",
    }
    before = of(tmp_path, files, "ours.m:g")
    swapped = files["m"].replace("ours.a import", "ours.b import")
    files["m"] = swapped.replace("import b", "import a as b")
    # The same units under the same names, called the other way round.
    assert of(tmp_path, files, "ours.m:g").digest != before.digest


def test_a_moved_helper_is_the_same(tmp_path):
    files = {"m": "def h(x): return 2 * x\ndef f(x): return h(x)\n", "n": ""}
    before = of(tmp_path, files, "ours.m:f")
    files = {"m": "from ours.n import h\ndef f(x): return h(x)\n", "n": "def h(x): return 2 * x\n"}
    after = of(tmp_path, files, "ours.m:f")
    assert after.digest == before.digest
    assert set(after.units) == {"ours.m:f", "ours.n:h"}


def test_a_table_is_not_followed_and_a_name_is(tmp_path):
    files = {
        "m": "def a(): return 1\ndef b(): return 2\nTABLE = {'a': a}\n"
        "def find(k): return TABLE[k]\ndef f(): return find('a')\n",
    }
    before = of(tmp_path, files, "ours.m:f ours.m:a", cut=["ours.m:TABLE"])
    files["m"] = files["m"].replace("{'a': a}", "{'a': a, 'b': b}")
    assert of(tmp_path, files, "ours.m:f ours.m:a", cut=["ours.m:TABLE"]).digest == before.digest
    by_name = {"ours.m:find": lambda name: [f"ours.m:{name}"]}
    cut = {"cut": ["ours.m:TABLE"], "by_name": by_name}
    assert "ours.m:a" in of(tmp_path, files, "ours.m:f", **cut).units


def test_lone_files_import_their_neighbours(tmp_path):
    (tmp_path / "mine.py").write_text("from near import K\ndef f(): return K\n")
    (tmp_path / "near.py").write_text("K = 1\n")

    def digest() -> str:
        tree = Tree({})
        top = tree.add_folder(tmp_path)
        return Digests(tree).of({"p": Part((f"{top}.mine:f",))})["p"].digest

    before = digest()
    assert digest() == before
    (tmp_path / "near.py").write_text("K = 2\n")
    assert digest() != before


def test_annotations_count_where_they_are_read(tmp_path):
    plain = "class C:\n    x: int = 1\n    def a(self): return self.x\ndef f(): return C().a()\n"
    fields = "from dataclasses import dataclass\n@dataclass\n" + plain
    other = ("x: int", "x: float")
    for text, counts in ((plain, False), (fields, True)):
        before = of(tmp_path, {"m": text}, "ours.m:f").digest
        after = of(tmp_path, {"m": text.replace(*other)}, "ours.m:f").digest
        assert (before != after) is counts


def test_what_cannot_be_parsed_is_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match="m.py, line 1: not valid Python"):
        of(tmp_path, {"m": "def f(:\n"}, "ours.m:f")
    with pytest.raises(KeyError):
        of(tmp_path, {"m": "def f(): pass\n"}, "ours.m:g")


def test_what_a_process_parsed_is_kept_for_the_next(tmp_path):
    code = "from harness.identity.ours import digests; digests().tree.unit('%s', 'ROOT')"
    subprocess.run(
        [sys.executable, "-c", code % "harness.core.paths"],
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)}, check=True, cwd=ROOT,
    )  # fmt: skip
    (file,) = tmp_path.glob("bsdf-sampling-harness/units-*.json")
    assert json.loads(file.read_text())


def test_the_cache_gives_the_same_and_may_be_damaged_or_unwritable(tmp_path):
    text = b"A = 1\ndef f(): return A\n"
    cache = Cache(tmp_path / "cache")
    first = cache.units(text)
    cache.save()
    (file,) = (tmp_path / "cache").iterdir()
    again = Cache(tmp_path / "cache")
    assert again.units(text)["units"].keys() == first["units"].keys()
    assert again.units(text)["units"]["f"]["hash"] == first["units"]["f"]["hash"]
    file.write_text("{")
    assert Cache(tmp_path / "cache").units(text)["bindings"] == first["bindings"]
    (tmp_path / "file").write_text("")
    nowhere = Cache(tmp_path / "file" / "below")
    nowhere.units(text)
    nowhere.save()
