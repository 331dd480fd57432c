"""``harness advise``: the method for so many samples, its margin and its range."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from harness.analysis.advise import advise
from harness.analysis.breakeven import costs
from harness.analysis.results import Results
from harness.cli.main import main
from harness.core.protocol.errors import InputError
from tests.report_results import Made

SCENE = "studio-sphere"
MATERIAL = "veined-marble"
LABELS = ["cosine", "improved-baseline", "two-lobe", "neural-spline-flow", "tabulated"]
MEASURES = ("fit", "equal-spp", "equal-time")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = Made(methods=LABELS, measures=MEASURES, bias={("two-lobe", "elephant-hide"): 1e-12})
    return made.write(tmp_path_factory.mktemp("advise"))


@pytest.mark.parametrize("samples", [1e2, 1e5, 1e7, 1e9, 1e12])
@pytest.mark.parametrize("shipped", [False, True])
def test_it_names_the_lowest_total_time(folder: Path, samples: float, shipped: bool) -> None:
    (said,) = advise(folder, MATERIAL, samples, shipped=shipped)
    found = costs(Results.load(folder), MATERIAL, SCENE, shipped)
    totals = {k: v.total(samples)[0] for k, v in found.lines.items() if not v.method.ceiling}
    best, second = sorted(totals, key=totals.get)[:2]
    assert (said.method, said.runner_up) == (best, second)
    assert said.margin.value == pytest.approx(totals[second] / totals[best])
    assert said.margin.low <= said.margin.value <= said.margin.high
    assert said.start is None or said.start.at <= samples
    assert said.end is None or samples <= said.end.at
    assert "tabulated" in said.left_out


def test_the_range_ends_where_another_takes_over(folder: Path) -> None:
    (here,) = advise(folder, MATERIAL, 1e4)
    assert here.method == "cosine" and here.start is None and here.end is not None
    (beyond,) = advise(folder, MATERIAL, 1.001 * here.end.at)
    assert beyond.method == here.end.method
    assert beyond.start.at == pytest.approx(here.end.at)
    assert beyond.start.method == "cosine"


def test_a_tie_is_said(folder: Path, tmp_path: Path) -> None:
    (here,) = advise(folder, MATERIAL, 1e4)
    (edge,) = advise(folder, MATERIAL, here.end.at * 1.0001)
    text = "\n".join(edge.lines())
    assert edge.tie and "a tie: the interval of the margin includes 1" in text
    assert not here.tie and "a tie" not in "\n".join(here.lines())


def test_a_biased_method_is_not_advised(folder: Path) -> None:
    (said,) = advise(folder, "elephant-hide", 1e9)
    assert said.method != "two-lobe"
    assert said.left_out["two-lobe"].startswith("biased")


def test_swept_methods_are_more_methods(tmp_path: Path) -> None:
    labels = ["cosine", "improved-baseline", "neural-spline-flow bins=5"]
    folder = Made(methods=labels, measures=MEASURES).write(tmp_path)
    (said,) = advise(folder, MATERIAL, 1e9)
    assert "neural-spline-flow bins=5" in {said.method, said.runner_up}


def test_every_scene_unless_one_is_named(tmp_path: Path) -> None:
    made = Made(methods=LABELS[:3], measures=MEASURES, scenes=(SCENE, "patch"))
    folder = made.write(tmp_path)
    assert [one.scene for one in advise(folder, MATERIAL, 1e6)] == [SCENE, "patch"]
    assert [one.scene for one in advise(folder, MATERIAL, 1e6, scene="patch")] == ["patch"]


def test_one_method_alone(tmp_path: Path) -> None:
    folder = Made(methods=["improved-baseline"], measures=MEASURES).write(tmp_path)
    (said,) = advise(folder, MATERIAL, 1e6)
    assert said.method == "improved-baseline" and said.runner_up == ""
    assert "no other method has a number" in "\n".join(said.lines())
    assert np.isnan(said.margin.value)


def test_nothing_timed_is_refused(tmp_path: Path) -> None:
    folder = Made(measures=("fit", "pdf")).write(tmp_path)
    with pytest.raises(InputError, match="equal-time or cost"):
        advise(folder, MATERIAL, 1e6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--material", "veined-marbel"], "did you mean 'veined-marble'?"),
        (["--material", MATERIAL, "--scene", "studio"], "did you mean 'studio-sphere'?"),
        (["--material", MATERIAL, "--samples", "0"], "--samples: expected a number above zero"),
        (["--material", MATERIAL, "--samples", "many"], "--samples"),
    ],
)
def test_refused_in_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    given = arguments if "--samples" in arguments else [*arguments, "--samples", "64e6"]
    assert main(["advise", str(folder), *given]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1 and message in err


def test_from_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["advise", str(folder), "--material", MATERIAL, "--samples", "64e6"]) == 0
    text = capsys.readouterr().out
    assert "64.0 M samples of improved-baseline" in text
    for word in ("use ", "runner-up ", "holds ", "left out "):
        assert f"  {word}" in text
    assert main(["advise", str(folder / "no"), "--material", MATERIAL, "--samples", "1"]) == 2
