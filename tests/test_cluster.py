"""Runs on a Dask cluster: the same numbers as here, files by content, workers that are lost."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from harness.cli.main import main
from harness.core.paths import ROOT
from harness.core.protocol.errors import InputError
from harness.runner import carried_files
from harness.runner.carried_files import CarriedFiles
from harness.runner.cluster import Cluster, connect
from harness.runner.run import Options
from harness.runner.task import MEASURE, Task
from harness.suite.load import load
from harness.suite.plan import make_plan
from tests.test_workers import LIMITS, go, numbers, suite

TIMED = {
    "measures": [
        {"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8},
        {"name": "throughput", "batch": 256, "rounds": 4, "least_seconds": 1e-4},
    ]
}


@pytest.fixture(autouse=True)
def of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worker_processes: None
) -> Iterator[None]:
    """No other run on this machine is waited for; workers find these modules."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return


@pytest.mark.parametrize(
    ("workers", "changes"), [(1, {}), pytest.param(2, TIMED, marks=pytest.mark.slow)]
)
def test_a_cluster_gives_the_same_numbers(
    tmp_path: Path, workers: int, changes: dict[str, Any]
) -> None:
    pytest.importorskip("distributed")
    path = suite(tmp_path / "s", "1", ["Type"], **changes)
    _, _, here = go(path, Options(limits=LIMITS))
    dask = Options(executor="dask", workers=workers, limits=LIMITS)
    code, text, there = go(path, dask, out="dask")
    assert code == 0, text
    assert set(here) == set(there), "times are of the same machine"
    assert {t.status for t in there.values()} == {"ok"}
    for method in ("cosine", "Good", "Type"):
        assert numbers(here, method) == numbers(there, method) != {}
    timed = [t for t in there.values() if t.labels["measure"] == "throughput"]
    for trial in timed:
        about = trial.environment
        assert about["machine"]["host"] and about["machine"]["cores"] == os.cpu_count()
        assert len(about["load"]) == 3 and about["clock"]


def test_files_travel_by_content(tmp_path: Path) -> None:
    (tmp_path / "weights.bin").write_bytes(b"1")
    method = {"name": "adapters.py:Good", "label": "Good"}
    path = suite(tmp_path / "s", "1", [], methods=["cosine", method])
    (path.parent / "beside.py").write_text("")
    plan = make_plan(load(path))
    files = carried_files.of(plan)
    adapter = path.parent / "adapters.py"
    assert files.content[str(adapter)] == adapter.read_bytes()
    assert str(path.parent / "beside.py") in files.content
    assert not [name for name in files.content if name.startswith(str(ROOT))]
    elsewhere = tmp_path / "elsewhere"
    files.unpack(elsewhere)
    task = Task(MEASURE, tuple(plan.trials), "cosine")
    moved = files.moved(task, elsewhere)
    names = {trial.method: trial.method_name for trial in moved.trials}
    assert names["cosine"] == "cosine"
    file, _, kind = names["Good"].rpartition(":")
    assert kind == "Good" and Path(file).is_relative_to(elsewhere)
    assert Path(file).read_bytes() == adapter.read_bytes()
    assert [trial.identity for trial in moved.trials] == [t.identity for t in plan.trials]


def test_names_of_files_in_parameters_are_changed(tmp_path: Path) -> None:
    weights = tmp_path / "w" / "weights.bin"
    files = CarriedFiles({str(weights): b"1"}, "/somewhere/harness", (str(tmp_path),))
    (trial, *_) = make_plan(load(suite(tmp_path / "s", "1", []))).trials
    params = {"file": str(weights), "short": ["w/weights.bin", 3], "other": "w/none.bin"}
    spec = {"name": "m", "file": "/somewhere/harness/suites/scenes/x.xml"}
    task = Task(MEASURE, (replace(trial, params=params, material_spec=spec),), "")
    (moved,) = files.moved(task, Path("/there")).trials
    place = f"/there{weights}"
    assert moved.params == {"file": place, "short": [place, 3], "other": "w/none.bin"}
    assert moved.material_spec["file"] == str(ROOT / "suites/scenes/x.xml")


def test_what_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "smoke", "--executor", "dsk"]) == 2
    assert "unknown executor 'dsk'; did you mean 'dask'" in capsys.readouterr().err
    assert main(["run", "smoke", "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert "expected --executor dask" in capsys.readouterr().err


class _Client:
    """Of a cluster whose one worker is away for a look, and comes back at another address."""

    cluster = None
    looks = 0

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        self.looks += 1
        there = {1: "tcp://10.0.0.7:1111", 2: None}.get(self.looks, "tcp://10.0.0.7:2222")
        return {"workers": {there: {}} if there else {}}

    def run(self, function: Any, device: str, workers: list[str], on_error: str) -> dict[str, Any]:
        return {address: {"identity": {"cpu": "a"}, "host": "h"} for address in workers}


def test_tasks_are_bound_to_hosts_and_wait_for_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """An address goes with the worker: bound to it, a task would wait for ever."""
    monkeypatch.setattr("harness.runner.cluster._WAIT", 0.01)
    cluster = Cluster(_Client(), "cpu", LIMITS)
    assert cluster.machine() == {"cpu": "a"}
    assert cluster._like({"cpu": "a"}) == ["10.0.0.7"]
    assert cluster.client.looks == 3
    monkeypatch.setattr("harness.runner.cluster._PATIENCE", 0.0)
    with pytest.raises(InputError, match="no worker runs on the machine"):
        cluster._like({"cpu": "b"})


@pytest.mark.slow
def test_nobody_at_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("harness.runner.cluster._CONNECT", 1.0)
    with pytest.raises(InputError, match="tcp://127.0.0.1:1: no scheduler answers there"):
        connect("tcp://127.0.0.1:1", 1)


@pytest.mark.slow
def test_workers_that_are_killed_lose_nothing(tmp_path: Path) -> None:
    """Ten times one of two, whichever and whatever it does."""
    pytest.importorskip("distributed")
    path = suite(
        tmp_path / "s", "1", [], materials=["disney", "layered"], seeds=[*range(8)], **TIMED
    )
    _, _, here = go(path, Options(limits=LIMITS), out="here")
    cluster = Cluster(connect(None, 2), "cpu", LIMITS)
    killed: list[int] = []
    over = threading.Event()

    def kill() -> None:
        def processes() -> dict[str, int]:
            return cluster.client.run(os.getpid, on_error="ignore")

        while len(killed) < 10 and not over.wait(1.0):
            found: dict[str, Any] = processes()
            if found:
                pid = list(found.values())[len(killed) % len(found)]
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        code, text, there = go(path, Options(executor=cluster, limits=LIMITS), out="there")
    finally:
        over.set()
        thread.join()
    assert code == 0, text
    assert killed and set(here) == set(there)
    for method in ("cosine", "Good"):
        assert numbers(here, method) == numbers(there, method) != {}
    time.sleep(1)
