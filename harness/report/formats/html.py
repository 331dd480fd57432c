"""HTML by templates (``harness/report/templates``), in which every text is escaped."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from harness.core.text import printable


def render(template: str, **values: Any) -> str:
    """A template filled with ``values``; what is missing is an error, not an empty place."""
    return _environment().get_template(template).render(**values)


def _seen(value: Any) -> Any:
    """A text with nothing in it that a page may not hold; markup is ours, and stays."""
    plain = isinstance(value, str) and not hasattr(value, "__html__")
    return printable(value) if plain else value


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("harness.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_seen,
        keep_trailing_newline=True,
    )
