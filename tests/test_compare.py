"""Do two runs agree? Folders made up with known intervals."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.analysis.compare import compare
from harness.cli.main import main
from harness.core.protocol.errors import InputError
from harness.core.record import Record
from harness.measures.base import Outcome
from harness.store import write as storing
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored

HERE = {"cpu": "Example CPU 3000", "cores": 2}


def write(
    folder: Path, values: dict[str, tuple[float, float, float]], *, started: str, machine=HERE
) -> Path:
    """A run with one trial a method: its ``time-ratio``, timed if there is a ``machine``."""
    folder.mkdir()
    rows = []
    with ResultsFolder(folder, write=True) as store:
        for i, (method, interval) in enumerate(values.items()):
            labels = {"suite": "made-up", "material": "suede", "method": method}
            labels |= {"scene": "", "measure": "cost", "seed": 0}
            identity = {"method": {"name": method}} | ({"machine": machine} if machine else {})
            about = Stored(f"{i:016x}", identity, labels, "ok", "", started=started, seconds=1.0)
            records = [Record("time-ratio", *interval, "1"), Record("batch", 8.0, unit="1")]
            storing.save(store, about, Outcome(records=records))
            rows.append({"trial": about.hash, "fit": "", "identity": identity, **labels})
        store.write_plan({"suite": "made-up"}, rows)
    return folder


MONDAY = {"a": (2.0, 1.9, 2.1), "b": (1.0, 0.9, 1.1), "base": (1.0, 1.0, 1.0), "c": (1.0, 0.5, 2.0)}
TUESDAY = {"a": (2.3, 2.2, 2.4), "b": (1.2, 1.1, 1.3), "base": (1.0, 1.0, 1.0)}


@pytest.fixture
def runs(tmp_path: Path) -> tuple[Path, Path]:
    return (
        write(tmp_path / "one", MONDAY, started="monday"),
        write(tmp_path / "two", TUESDAY, started="tuesday"),
    )


def test_overlap_and_width(runs: tuple[Path, Path]) -> None:
    """Touching intervals overlap; a definition (no width) and what one run lacks do not count."""
    found, left_out = compare(*runs)
    (agreement,) = found
    assert (agreement.measure, agreement.metric) == ("cost", "time-ratio")
    assert (agreement.pairs, agreement.overlapping) == (2, 1)
    assert agreement.widest == pytest.approx(0.2)
    assert agreement.width == pytest.approx((0.1 + 0.2 / 1.2) / 2)
    assert agreement.apart == ("a · suede · seed 0: 2.00 [1.90, 2.10] and 2.30 [2.20, 2.40]",)
    assert not left_out
    swapped, _ = compare(*reversed(runs))
    assert swapped[0].overlapping == 1


def test_a_run_is_not_compared_with_itself(runs: tuple[Path, Path]) -> None:
    with pytest.raises(InputError, match="nothing to compare .3 numbers are of one and the same"):
        compare(runs[0], runs[0])


def test_times_of_two_machines_are_not_compared(tmp_path: Path) -> None:
    one = write(tmp_path / "one", MONDAY, started="monday")
    other = write(tmp_path / "other", TUESDAY, started="tuesday", machine=HERE | {"cores": 64})
    with pytest.raises(InputError, match="2 times were taken on different machines"):
        compare(one, other)


def test_what_is_no_time_may_come_from_anywhere(tmp_path: Path) -> None:
    one = write(tmp_path / "one", MONDAY, started="monday", machine=None)
    other = write(tmp_path / "other", TUESDAY, started="tuesday", machine=None)
    assert compare(one, other)[0][0].pairs == 2


def test_unknown_metric(runs: tuple[Path, Path]) -> None:
    with pytest.raises(InputError, match="'time-ratoi'; did you mean 'time-ratio'"):
        compare(*runs, metrics=("time-ratoi",))


def test_verb(runs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", *map(str, runs), "--metric", "time-ratio"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("cost time-ratio: 1 of 2 intervals overlap")
    assert "  apart    a · suede" in said
    assert main(["compare", str(runs[0]), str(runs[0].parent)]) == 2
    assert "holds no results" in capsys.readouterr().err
