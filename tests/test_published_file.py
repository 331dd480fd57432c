"""A published database is one compressed file: the same results, checked, made plain to go on."""

from __future__ import annotations

import lzma
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from harness import load_results
from harness.analysis import status
from harness.core.paths import ROOT
from harness.core.protocol.errors import InputError
from harness.identity import small
from harness.report import write as reports
from harness.report.formats.markdown import markdown
from harness.store import whole
from harness.store.database import FILE, is_ours
from harness.store.folder import ResultsFolder
from harness.store.lock import locked
from harness.store.mend import mend
from harness.store.publish import publish
from harness.store.whole import WHOLE
from tests import stores
from tests.report_results import Made
from tests.stores import KEYS


@pytest.fixture
def published(tmp_path: Path) -> Path:
    source = stores.make(tmp_path / "source")
    (source / "suite.yaml").write_text("name: s\n")
    assert publish(source, tmp_path / "copy") == len(KEYS)
    return tmp_path / "copy"


def edited(folder: Path, statement: str, *values: object) -> None:
    """The database changed behind the store's back, compressed again."""
    with closing(whole.opened(folder / WHOLE)) as connection:
        connection.execute(statement, values)
        whole.write(connection, folder / WHOLE)


def test_the_copy_reads_as_the_original_does(published: Path):
    assert {p.name for p in published.iterdir()} == {WHOLE, "suite.yaml"}
    source = published.parent / "source"
    pd.testing.assert_frame_equal(load_results(published), load_results(source))
    with ResultsFolder(published) as copy, ResultsFolder(source) as store:
        for key in KEYS:
            ours, theirs = copy.arrays(key), store.arrays(key)
            assert {n: a.tolist() for n, a in ours.items()} == {
                n: a.tolist() for n, a in theirs.items()
            }
            assert copy.trial(key).documents == store.trial(key).documents
            assert copy.trial(key).parts == store.trial(key).parts
        assert copy.plan() == store.plan() and copy.lost() == ""
        with pytest.raises(InputError, match="readonly|read-only"), copy.writing():
            copy.run("DELETE FROM trial")
    assert is_ours(published) and status.folders(published.parent) == [published, source]


def test_tables_of_a_copy_are_those_of_the_original(tmp_path: Path):
    source = Made(materials=["suede", "brocade"], size=16).write(tmp_path / "source")
    (source / "suite.yaml").write_text("name: synthetic\n")
    publish(source, tmp_path / "copy")
    one, other = (reports.load(tmp_path / name) for name in ("source", "copy"))
    assert len(one.tables) > 5
    assert [markdown(table) for table in other.tables] == [markdown(table) for table in one.tables]


def test_what_is_damaged_is_said_in_one_line(published: Path):
    path = published / WHOLE
    data = path.read_bytes()
    for spoiled in (
        data[:-40], data + b"more", data[: len(data) // 2], b"", b"no file of xz at all",
        bytes([*data[:300], data[300] ^ 1, *data[301:]]),
    ):  # fmt: skip
        path.write_bytes(spoiled)
        for read in (load_results, lambda folder: ResultsFolder(folder, write=True)):
            with pytest.raises(InputError, match=f"{WHOLE}: is damaged .*take it anew") as found:
                read(published)
            assert "\n" not in str(found.value)
        assert path.read_bytes() == spoiled, "nothing is lost"
    path.write_bytes(lzma.compress(b"no database" * 1000))
    with pytest.raises(InputError, match="damaged"):
        load_results(published)


def test_what_stands_in_it_is_compared_with_its_checksum(published: Path):
    edited(published, "UPDATE blob SET body = replace(body, x'00', x'01')")
    edited(published, "UPDATE trial SET body = body || ' ' WHERE trial = ?", KEYS[0])
    found = load_results(published).set_index("trial")
    assert "does not match its checksum" in found.loc[KEYS[0], "reason"]
    assert set(found["status"]) == {"error"} and "is damaged" in found.loc[KEYS[1], "reason"]


def test_too_much_is_refused(published: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(whole, "_MOST", 10_000)
    with pytest.raises(InputError, match="more than 10,000 bytes"):
        load_results(published)


def test_a_run_makes_it_plain_and_goes_on(published: Path):
    before = load_results(published)
    said: list[str] = []
    with locked(published):
        mend(published, said.append)
        with ResultsFolder(published, write=True) as store:
            stores.save(store, "f" * 16, 3)
    assert said == []
    assert (published / FILE).exists() and not (published / WHOLE).exists()
    pd.testing.assert_frame_equal(load_results(published), before)
    assert load_results(published, all=True)["value"].tolist() == [0, 1, 2, 3]
    with closing(sqlite3.connect(published / FILE)) as connection:
        assert connection.execute("PRAGMA quick_check").fetchone() == ("ok",)


def test_a_copy_may_be_published_in_its_own_place(published: Path):
    before, data = load_results(published), (published / WHOLE).read_bytes()
    publish(published, published)
    assert {p.name for p in published.iterdir()} == {WHOLE, "suite.yaml"}
    pd.testing.assert_frame_equal(load_results(published), before)
    assert (published / WHOLE).read_bytes() == data


def test_a_file_that_is_replaced_is_read_anew(published: Path):
    (key, *_) = KEYS
    with ResultsFolder(published) as store:
        first = store.trial(key)
    assert first.arrays["numbers"][0] == 0
    source = published.parent / "source"
    with ResultsFolder(source, write=True) as store:
        stores.save(store, key, 9)
    publish(source, published)
    with ResultsFolder(published) as store:
        assert store.trial(key).arrays["numbers"][0] == 9


def test_large_images_go_along_of_the_methods_named_to_two_digits(tmp_path: Path):
    made = Made(materials=["suede", "brocade"], measures=("pictures", "equal-time"))
    source = made.write(tmp_path / "source")
    shown, scene = "suede", "studio-sphere"
    publish(source, tmp_path / "copy", [f"{shown}/{scene}"], ["improved-baseline", "cosine"])
    with ResultsFolder(tmp_path / "copy") as copy, ResultsFolder(source) as store:
        trials, kept = store.trials(), 0
        for key, trial in copy.trials().items():
            labels = trial.labels
            there = labels["material"] == shown and labels["scene"] == scene
            there &= labels["measure"] == "pictures"
            there &= labels["method"] in ("improved-baseline", "cosine")
            assert bool(trial.files) == (there and bool(trials[key].files))
            for name in trial.files:
                kept += 1
                found, right = (t.images[Path(name).stem] for t in (trial, trials[key]))
                np.testing.assert_allclose(found, right, rtol=2.0**-6, atol=0)
        assert kept >= 2


def test_of_long_arrays_probes_keep_what_is_compared():
    rows = np.random.default_rng(0).normal(size=(1024, 32)).astype(np.float32)
    whole = {"state": rows, "notes": np.zeros(9000, np.uint8), "few": rows[:2]}
    short = small.thinned(whole)
    assert short["state"].size <= small.MANY and short["notes"].size == 9000
    assert (short["few"] == rows[:2]).all()
    # What is kept stays as it is, every column among it, and compares with the whole.
    assert all((small.thinned(short)[name] == short[name]).all() for name in short)
    numbers = np.arange(rows.size, dtype=np.float32).reshape(rows.shape)
    assert set(small.thinned({"n": numbers})["n"] % 32) == set(range(32))
    for change, same in ((1e-6, True), (1e-3, False)):
        other = whole | {"state": rows * np.float32(1 + change)}
        assert small.agree(short, other) == same and not small.identical(short, other)


def test_no_places_of_one_machine_go_along(tmp_path: Path):
    raw = tmp_path / "raw"
    folder = Made().write(raw)
    outside = {"material": {"leather": {"/home/me/a.bsdf": "1", "suites/table2.yaml": "2"}}}
    with locked(folder), ResultsFolder(folder, write=True) as results:
        plan, trials = results.plan(), results.trials()
        about = {k: v for k, v in plan.items() if k != "trials"} | {"files": outside}
        results.write_plan(about, plan["trials"])
        first = next(iter(trials.values()))
        text = f'File "{ROOT}/harness/a.py", line 1'
        results.save(replace(first, traceback=text), results.arrays(first.hash), {})
    publish(folder, tmp_path / "out")
    with ResultsFolder(tmp_path / "out") as copy:
        assert copy.plan()["files"] == {"material": {"leather": {"suites/table2.yaml": "2"}}}
        assert copy.trials()[first.hash].traceback == 'File "harness/a.py", line 1'
