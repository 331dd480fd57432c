"""What ``harness bench`` refuses, in one line."""

from __future__ import annotations

import pytest

from harness.cli.main import main


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--material", "leather"], "material 'leather' is no Mitsuba BSDF"),
        (["--profile", "--device", "cuda"], "device is 'cuda'; expected cpu"),
    ],
)
def test_what_is_refused(options: list[str], said: str, capsys: pytest.CaptureFixture[str]):
    assert main(["bench", "cosine", *options]) == 2
    assert said in capsys.readouterr().err
