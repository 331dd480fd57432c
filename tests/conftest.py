"""Fixtures that several test files share."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

LONGEST = """
    workers methods image_checks planted_samplers page_browser checks report effects_measure knobs
    measures histograms importance_baked examples cost importance_measure cluster neural_shipped
    stats_coverage flow_matching flows runner shipped_fits api rendering identity_probes
    process_repeats cli
""".split()
"""Files by how long they take: they are begun first, so that no process waits for the last."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """One more than cores: some tests wait for processes of their own, or for a limit of time.

    None where the environment says how many, which is for pytest-xdist to read.
    """
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return len(os.sched_getaffinity(0)) + 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first; tests of a file stay together and in order."""
    order = {f"test_{name}": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


def pytest_collection_finish() -> None:
    """What was imported and collected stays: the collector of garbage need not look at it again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def in_this_process() -> None:
    """Runs carry out their trials here: worker processes have to import everything first.

    And they plan anew, whatever was found before: code may be replaced by a test.
    """
    from harness.runner import answer_cache, executor

    executor.default, answer_cache.enabled = executor.INLINE, False


@pytest.fixture
def worker_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of the test have worker processes, as they have outside of tests."""
    from harness.runner import executor

    monkeypatch.setattr(executor, "default", executor.LOCAL)


@pytest.fixture(autouse=True)
def without_probes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs keep probes of their code where the test is marked ``probes``: they take seconds."""
    if request.node.get_closest_marker("probes") is None:
        monkeypatch.setattr("harness.runner.probes.Probes.keep", lambda *_: None)


@pytest.fixture(scope="module")
def failing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of three materials, six methods; an error, an unsupported method, a biased one."""
    from tests.report_results import METHODS, Made

    return Made(
        methods=[*list(METHODS)[:4], "tabulated", "neural-spline-flow"],
        fail={
            ("equal-time", "blinn-phong", "veined-marble"): ("error", "it_broke & burned: 50%"),
            (None, "neural-spline-flow", "quilted-satin"): ("unsupported", "too | shiny"),
        },
        bias={("fan-baseline", "elephant-hide"): 1e-12},
    ).write(tmp_path_factory.mktemp("failing"))


@pytest.fixture
def switched(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Sets the environment variable, and has the library looked for again before and after."""
    from harness.core.compiled import instruction_sets, library

    def switch(name: str) -> None:
        monkeypatch.setenv(instruction_sets.VARIABLE, name)
        library.found.cache_clear()

    yield switch
    monkeypatch.undo()
    library.found.cache_clear()
