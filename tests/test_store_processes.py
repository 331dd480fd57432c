"""A store and other processes: killed in the middle, reading while one writes, short of disk."""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from harness import load_results
from harness.core.protocol.errors import InputError
from harness.measures.base import Outcome
from harness.store import folder as folders
from harness.store import write
from harness.store.database import FILE
from harness.store.folder import ResultsFolder
from harness.store.lock import locked
from harness.store.mend import mend
from harness.store.stored import Stored
from tests import stores
from tests.stores import KEYS


def child(work: Callable[[], object]) -> int:
    """A forked process that does ``work``; its number."""
    number = os.fork()
    if number:
        return number
    status = 1
    try:
        work()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def told(work: Callable[[], object]) -> str:
    """What a process of its own is refused with; "" if it is not."""
    here, there = os.pipe()

    def tell() -> None:
        try:
            work()
        except InputError as error:
            os.write(there, str(error).encode())

    process = child(tell)
    os.close(there)
    with os.fdopen(here, "rb") as pipe:
        text = pipe.read().decode()
    assert os.waitpid(process, 0)[1] == 0
    return text


def test_a_kill_at_any_moment_leaves_whole_trials(tmp_path: Path):
    folder, rng = stores.make(tmp_path / "out", noise=500), random.Random(0)

    def forever() -> None:
        number = 0
        with ResultsFolder(folder, write=True) as store:
            while True:
                number += 1
                key = f"{number % 7:016x}"
                stores.save(store, key, number, noise=500, image=False)

    seen = set()
    for _ in range(20):
        process = child(forever)
        time.sleep(rng.uniform(0.01, 0.15))
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        with ResultsFolder(folder) as store:
            store.check()
            seen.add(stores.consistent(store))
        with locked(folder):
            mend(folder, lambda text: pytest.fail(text))
    assert max(seen) > len(KEYS), "something was saved meanwhile"


def test_a_kill_when_half_is_on_the_disk_already(tmp_path: Path):
    """More than fits into memory pages was written; whoever reads next takes it back."""
    folder = stores.make(tmp_path / "out")
    before = load_results(folder)
    large = {f"n{i}": np.random.default_rng(i).random(1 << 19) for i in range(3)}

    def killed() -> None:
        packed = folders.pack

        def pack(data: bytes, dictionary: bytes = b"", most: int = 0) -> bytes:
            if len(data) < 1 << 20:  # the body, the last of all
                assert (folder / f"{FILE}-journal").exists()
                os.kill(os.getpid(), signal.SIGKILL)
            return packed(data)

        folders.pack = pack
        with ResultsFolder(folder, write=True) as store:
            about = Stored(KEYS[0], {}, stores.labels(0), "ok", "")
            write.save(store, about, Outcome(arrays=large))

    process = child(killed)
    assert os.WTERMSIG(os.waitpid(process, 0)[1]) == signal.SIGKILL
    assert (folder / f"{FILE}-journal").exists(), "the transaction was open"
    assert load_results(folder).equals(before)
    with ResultsFolder(folder, write=True) as store:
        store.check()
        assert stores.consistent(store) == len(KEYS)


def test_two_readers_see_whole_trials_while_one_writes(tmp_path: Path):
    folder = stores.make(tmp_path / "out", noise=2000)
    stop = tmp_path / "stop"

    def read() -> None:
        rounds = 0
        while not stop.exists() or rounds < 5:
            with ResultsFolder(folder) as store, store.as_it_is():
                count = stores.consistent(store)
                assert count == len(store.keys()) >= len(KEYS)
                assert len(store.plan()["trials"]) == len(KEYS)
            frame = load_results(folder)
            assert set(frame["status"]) == {"ok"}
            rounds += 1

    readers = [child(read) for _ in range(2)]
    with ResultsFolder(folder, write=True) as store:
        for number in range(1, 40):
            stores.save(store, f"{number % 9:016x}", number, noise=2000, image=False)
            if number % 10 == 0:
                store.tidy()
    stop.touch()
    assert [os.waitpid(reader, 0)[1] for reader in readers] == [0, 0]


@pytest.fixture
def everybodys() -> Iterator[Path]:
    """A folder that other users may enter."""
    folder = Path(tempfile.mkdtemp(prefix="harness-test-"))
    folder.chmod(0o755)
    yield folder
    folder.chmod(0o755)
    for path in (*folder.rglob("*"), folder):
        path.chmod(0o755)
    shutil.rmtree(folder)


def unprivileged() -> None:
    """No rights of the administrator, for whom no folder is read-only."""
    if os.getuid() == 0:
        os.setgid(65534)
        os.setuid(65534)


def test_a_read_only_folder_can_be_read_and_refuses_a_run(everybodys: Path):
    folder = stores.make(everybodys / "out", noise=10)
    before = load_results(folder)
    for path in (folder / FILE, folder):
        path.chmod(0o555 if path.is_dir() else 0o444)

    def read() -> None:
        unprivileged()
        assert load_results(folder).equals(before)

    def lock() -> None:
        unprivileged()
        with locked(folder):
            pass

    def save() -> None:
        unprivileged()
        with ResultsFolder(folder, write=True) as store:
            stores.save(store, KEYS[0], 7, noise=10, image=False)

    assert told(read) == ""
    assert told(lock) == f"{folder}: cannot be written: Permission denied"
    text = told(save)
    assert text.startswith(f"{folder / FILE}: cannot be ") and "read-only" in text
    below = everybodys / "out" / "new"

    def make() -> None:
        unprivileged()
        with locked(below):
            pass

    assert told(make) == f"{below}: cannot be made: Permission denied"
    assert load_results(folder).equals(before)


@pytest.mark.parametrize("state", [False, True])
def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path: Path, state: bool):
    folder = stores.make(tmp_path / "out", noise=100)
    before = load_results(folder)
    size = (folder / FILE).stat().st_size

    def fill() -> None:
        most = 1000 if state else size + 30_000
        with ResultsFolder(folder, write=True) as store:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
            for number in range(1000):
                if state:
                    about = Stored(f"{number:016x}", {}, stores.labels(0), "ok", "")
                    write.save(store, about, Outcome(tensors={"w": torch.zeros(1000)}))
                stores.save(store, f"{number:016x}", number, noise=2000, image=False)

    text = told(fill)
    assert "\n" not in text and text.startswith(str(folder))
    assert "File too large" in text if state else "the disk is full" in text
    with locked(folder):
        mend(folder, lambda said: pytest.fail(said))
    with ResultsFolder(folder, write=True) as store:
        assert stores.consistent(store) >= len(KEYS)
        store.tidy()
        stores.save(store, "f" * 16, 5, image=False)
    assert load_results(folder).equals(before)
    assert not list((folder / "files").glob(".tmp*"))
