"""Fixtures that several test files share."""

from __future__ import annotations

from pathlib import Path

import pytest


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
