"""One HTML file of a template, a style, scripts and plain data; nothing from elsewhere."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

from harness.report.formats.html import render
from harness.report.page.plain import script_json


def whole(
    title: str,
    facts: Sequence[str],
    scripts: Sequence[str],
    data: Any,
    pixels: Any = (),
    plots: bool = False,
) -> str:
    """The document. ``scripts`` are files of ``assets`` in the order in which they run;
    ``plots``: whether they draw with Plotly."""
    return render(
        "page.html",
        title=title,
        facts=" · ".join(facts),
        style=asset("page.css"),
        scripts=[asset(name) for name in scripts],
        data=script_json(data),
        pixels=script_json(list(pixels)),
        plotly=plotly() if plots else "",
    )


@cache
def asset(name: str) -> str:
    """A file of ``assets``, to be inlined."""
    text = (resources.files("harness.report.page") / "assets" / name).read_text("utf-8")
    if "</script" in text or "</style" in text:
        raise ValueError(f"{name}: would end the element that it stands in")
    return text


@cache
def plotly() -> str:
    """Plotly's script, deflated and in base64: the page unpacks it when the first plot is seen."""
    from plotly.offline import get_plotlyjs

    return base64.b64encode(zlib.compress(get_plotlyjs().encode("utf-8"), 9)).decode("ascii")
