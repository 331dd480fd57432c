"""Worker processes: a bad adapter costs its own trials, a killed run leaves nobody behind."""

from __future__ import annotations

import io
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rich.console import Console

from harness.analysis.results import Results
from harness.analysis.status import status
from harness.cli.main import main
from harness.core.protocol.method import Budget
from harness.report.tables.status import status as table_of
from harness.runner import global_state, limits
from harness.runner.limits import Limits
from harness.runner.local import how
from harness.runner.run import Options, run
from harness.runner.task import CHECK, MEASURE, Task
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored
from harness.suite.load import load
from harness.suite.plan import make_plan
from harness.suite.trials import Trial
from tests import bad_adapters
from tests.bad_adapters import BAD, SHORT, Bad

ROOT = Path(__file__).resolve().parents[1]
MEMORY = 2.5 * 2**30
LIMITS, HANGING = Limits(120.0, MEMORY), Limits(1.0, MEMORY)
"""Of trials that end, which take a tenth of a second, and of those that do not."""


@pytest.fixture(autouse=True)
def of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worker_processes: None) -> None:
    """No other run on this machine is waited for."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))


@pytest.fixture
def mark() -> Iterator[str]:
    """How long left processes sleep: a number that no other process has. None may be left."""
    number = f"{random.SystemRandom().randrange(10**8, 10**9)}.5"
    yield number
    assert gone(number), "a process is left"


def running(mark: str) -> list[str]:
    """Processes with ``mark`` in their command line."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if mark.encode() in file.read_bytes():
                found.append(file.parent.name)
        except OSError:
            continue
    return found


def gone(mark: str, seconds: float = 10.0) -> bool:
    """Whether no process with the mark runs, after a while at most."""
    end = time.monotonic() + seconds
    while running(mark):
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def suite(folder: Path, mark: str, names: list[str], **changes: Any) -> Path:
    """A suite of cosine, Good and adapters by name, to one cheap material."""
    folder.mkdir(exist_ok=True)
    bad_adapters.write(folder / "adapters.py", mark)
    data = {
        "name": "bad",
        "materials": ["disney"],
        "methods": ["cosine", "adapters.py:Good", *(f"adapters.py:{name}" for name in names)],
        "baseline": "cosine",
        "budget": {"steps": 1, "pool": 16, "conditions": 4, "directions": 4, "resolution": 8},
        "measures": [{"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8}],
    } | changes
    path = folder / "suite.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def go(path: Path, options: Options, out: str = "out") -> tuple[int, str, dict[str, Stored]]:
    """Run a suite; exit status, what was said, and all stored trials."""
    text, folder = io.StringIO(), path.parent / out
    code = run(make_plan(load(path)), folder, options, Console(file=text, width=300))
    with ResultsFolder(folder) as store:
        return code, text.getvalue(), store.trials()


def go_twice(path: Path, bad: list[Bad]) -> dict[str, Stored]:
    """Run a suite: without those that hang, then those alone; all stored trials."""
    hang = [b.name for b in bad if b.fails == "timeout"]
    rest = ["cosine", "Good", *(b.name for b in bad if b.fails != "timeout")]
    for names, some in ((rest, LIMITS), (hang, HANGING)):
        code, text, stored = go(path, Options(only=f"method={','.join(names)}", limits=some))
        assert code == 1, text
    return stored


def numbers(stored: dict[str, Stored], method: str) -> dict[tuple[Any, ...], Any]:
    """Records of a method that are no times, bit for bit."""
    return {
        (*(trial.labels[k] for k in ("material", "seed", "measure")), r["metric"]): (
            r["value"],
            r["ci_low"],
            r["ci_high"],
        )
        for trial in stored.values()
        if trial.labels["method"] == method and trial.labels["measure"] != "throughput"
        for r in trial.records
        if "seconds" not in r["metric"] and "nan" not in str(r.values())
    }


def judged(bad: Bad, stored: dict[str, Stored]) -> str:
    """What is wrong with what is stored of a bad adapter; "" if nothing."""
    trials = [t for t in stored.values() if t.labels["method"] == bad.name]
    first = [t for t in trials if t.status != "skipped"]
    said = [t.reason for t in first if t.status == bad.fails]
    if not bad.fails:
        bad_ends = [t.status for t in trials if t.status != "ok"]
        if bad_ends:
            return f"{bad.name}: {bad_ends}: {[t.reason for t in trials]}"
        said = [finding for t in trials for finding in t.findings]
        if not bad.says:
            return f"{bad.name}: {said}" if said else ""
    found = any(bad.pattern.search(text) for text in said)
    return "" if found else f"{bad.name}: {[(t.status, t.reason, t.findings) for t in trials]}"


def test_bad_adapters_cost_their_own_trials(tmp_path: Path, mark: str) -> None:
    _, _, alone = go(suite(tmp_path / "alone", mark, []), Options(limits=LIMITS))
    chosen = [bad for bad in BAD if bad.name in SHORT]
    stored = go_twice(suite(tmp_path / "bad", mark, list(SHORT)), chosen)
    assert not [said for bad in chosen if (said := judged(bad, stored))]
    assert len(stored) == 2 * (2 + len(SHORT)), "every trial has a row"
    for method in ("cosine", "Good"):
        assert numbers(stored, method) == numbers(alone, method) != {}
    line = "Type changes torch's default dtype from torch.float32 to torch.float64"
    assert status(tmp_path / "bad" / "out").findings[line] == 1
    (table,) = (s for s in table_of(Results.load(tmp_path / "bad" / "out")).sections)
    assert [line] == [c.text for r in table.rows for c in r.cells if "default dtype" in c.text]
    assert os.getcwd() == str(Path.cwd())


def test_what_torch_does_to_itself_is_no_finding(tmp_path: Path):
    """It replaces functions of its own when an optimiser first steps; a lobe's fit does that."""
    suite = {
        "name": "plain",
        "materials": ["rim-lobe"],
        "methods": ["improved-baseline"],
        "measures": [{"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8}],
        "budget": {"steps": 2, "conditions": 8, "directions": 8, "resolution": 8, "pool": 16},
        "report": {"tables": [], "figures": []},
    }
    file = tmp_path / "plain.yaml"
    file.write_text(yaml.safe_dump(suite))
    assert main(["run", str(file), "--out", str(tmp_path / "out"), "--executor", "local"]) == 0
    with ResultsFolder(tmp_path / "out") as store:
        found = store.trials().values()
        assert len(found) == 2 and not [finding for trial in found for finding in trial.findings]


@pytest.mark.slow
def test_two_at_a_time_give_the_same_numbers(tmp_path: Path, mark: str) -> None:
    """Fits with states that are drawn, and one that is optimised; fits and measures interleave."""
    changes = {"materials": ["disney", "layered"], "seeds": [0, 1]}
    path = suite(tmp_path / "s", mark, [], **changes)
    path.write_text(path.read_text().replace("- cosine\n", "- cosine\n- blinn-phong\n"))
    _, _, one = go(path, Options(limits=LIMITS), out="one")
    code, text, two = go(path, Options(limits=LIMITS, workers=2), out="two")
    assert code == 0, text
    assert set(one) == set(two) and len(one) == 2 * 2 * 3 * 2
    for key, trial in one.items():
        assert two[key].status == trial.status == "ok"
        assert two[key].state == trial.state, "fitted to the same bits"
    for method in ("blinn-phong", "Good"):
        assert numbers(one, method) == numbers(two, method) != {}


def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path, mark: str) -> None:
    """Its fit kills its worker twice, from outside as it were; the third goes well."""
    path = suite(tmp_path / "s", mark, [])
    counted = tmp_path / "count"
    with (path.parent / "adapters.py").open("a") as file:
        file.write(f"""

class KilledTwice(Good):
    def trouble(self):
        with open({str(counted)!r}, "a") as file:
            file.write("x")
        if os.path.getsize({str(counted)!r}) < 3:
            os.kill(os.getpid(), signal.SIGKILL)
""")
    text = path.read_text().replace("- adapters.py:Good", "- adapters.py:KilledTwice")
    path.write_text(text)
    code, text, stored = go(path, Options(limits=LIMITS, only="method=KilledTwice"))
    assert code == 0, text
    assert {t.status for t in stored.values()} == {"ok"}


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGKILL,
        *(pytest.param(n, marks=pytest.mark.slow) for n in (signal.SIGTERM, signal.SIGHUP)),
    ],
)
def test_a_run_that_is_killed_leaves_nobody(tmp_path: Path, mark: str, number: int) -> None:
    path = suite(tmp_path / "s", mark, [])
    with (path.parent / "adapters.py").open("a") as file:
        file.write("""

class Endless(Good):
    def trouble(self):
        subprocess.Popen(["sleep", MARK])
        subprocess.Popen(["sleep", MARK], start_new_session=True)
        subprocess.run(["sleep", MARK])
""")
    path.write_text(path.read_text().replace("- adapters.py:Good", "- adapters.py:Endless"))
    command = [sys.executable, "-m", "harness", "run", str(path), "--out", str(tmp_path / "out")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    process = subprocess.Popen(
        [*command, "--only", "method=Endless"], env=environment, stdout=subprocess.DEVNULL
    )
    end = time.monotonic() + 120
    while len(running(mark)) < 3 and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.05)
    assert len(running(mark)) == 3
    process.send_signal(number)
    process.wait()
    assert gone(mark)


def trial(**budget: Any) -> Trial:
    """A fit with a budget."""
    about = dict.fromkeys(("suite", "material", "method", "scene"), "")
    return Trial("h", {}, **about, measure="fit", seed=0, method_name="cosine",
                 budget=Budget(**budget))  # fmt: skip


def test_limits_of_time() -> None:
    def seconds(kind: str = MEASURE, **budget: Any) -> float:
        return Limits().seconds_of(Task(kind, (trial(**budget),), ""))

    assert seconds(max_seconds=5) == 5 * limits.SLACK + limits.GRACE
    assert seconds(seconds=10) < seconds(steps=1000) < seconds(steps=1000, until=0.1)
    assert seconds(CHECK) == limits.CHECK_SECONDS
    assert Limits(7.0).seconds_of(Task(MEASURE, (trial(),) * 3, "")) == 21.0
    with pytest.raises(ValueError, match="--trial-seconds: expected more than zero"):
        Limits(0.0)


def test_limits_of_memory() -> None:
    assert Limits(memory=5.0).memory_of(3) == 5.0
    assert 0 < Limits().memory_of(2) <= limits.available()
    assert limits.resident(os.getpid()) > 10 * 2**20
    assert limits.resident(2**22 + 1) == 0


def test_how_a_process_ended() -> None:
    assert "exit status 0 in the middle" in how(0)
    assert "exit status 3" in how(3 << 8)
    assert how(signal.SIGSEGV) == "its process was ended by SIGSEGV"
    assert "memory" in how(signal.SIGKILL, 3)


def test_nothing_changed_is_no_finding() -> None:
    before = global_state.look()
    assert global_state.changes(before, global_state.look(before)) == []
    assert global_state.changes(before, global_state.look()) == []


@pytest.mark.slow
def test_every_bad_adapter(tmp_path: Path, mark: str) -> None:
    """With timed trials beside them."""
    timed = {
        "measures": [
            {"name": "pdf", "conditions": 4, "resolution": 8, "samples": 8},
            {"name": "throughput", "batch": 256, "rounds": 4, "least_seconds": 1e-4},
        ]
    }
    _, _, alone = go(suite(tmp_path / "alone", mark, [], **timed), Options(limits=LIMITS))
    names = [bad.name for bad in BAD]
    assert len(names) >= 40
    stored = go_twice(suite(tmp_path / "bad", mark, names, **timed), BAD)
    assert not [said for bad in BAD if (said := judged(bad, stored))]
    assert len(stored) == 3 * (2 + len(names))
    for method in ("cosine", "Good"):
        assert numbers(stored, method) == numbers(alone, method) != {}
        assert {t.status for t in stored.values() if t.labels["method"] == method} == {"ok"}
