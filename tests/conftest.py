"""Fixtures that several test files share."""

from __future__ import annotations

from pathlib import Path

import pytest


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
