"""``python -m harness.report.manual [docs/suites.md]``: write the generated part anew, or print it.

What stands above the mark in the file is written by hand and stays.
"""

from __future__ import annotations

import sys
from pathlib import Path

from harness.mitsuba_runtime import variant

MARK = "<!-- From here on made by python -m harness.report.manual docs/suites.md -->"


def renewed(text: str, generated: str) -> str:
    """The file's text with its generated part replaced."""
    return f"{text.partition(MARK)[0].rstrip()}\n\n{MARK}\n\n{generated}"


def main() -> None:
    """Print the manual, or write it to the file that is named."""
    variant.use("cpu")  # measures that render name Mitsuba's classes
    from harness.report.manual.text import manual

    if len(sys.argv) < 2:
        print(manual(), end="")
        return
    path = Path(sys.argv[1])
    text = path.read_text("utf-8")
    if MARK not in text:
        sys.exit(f"{path}: has no line {MARK!r}, below which it would be written anew")
    path.write_text(renewed(text, manual()), encoding="utf-8")


if __name__ == "__main__":
    main()
