"""What goes to a terminal: nothing in it does anything but be seen, and a closed pipe is one line.

Names and reasons come from suites, adapters and other people's results. An escape sequence in one
could retitle a window, hide a line or write what looks like a prompt.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from harness.core.text import printable


class OutputLost(BaseException):
    """The output cannot be written to: its reader is gone, or its disk is full.

    Not an :class:`Exception`, lest it be taken for the failure of whatever was being done.
    """


class Screen(Console):
    """A console that prints texts as they are, control characters written out."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """See :meth:`rich.console.Console.render`."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment(printable(segment.text), segment.style)


@contextmanager
def guarded() -> Iterator[None]:
    """Inside, all that is printed is printable, in whatever characters the output has.

    Raises:
        OutputLost: what was printed cannot be written.
    """
    out, error = sys.stdout, sys.stderr
    for stream in (out, error):
        with suppress(AttributeError, ValueError):  # one that is no file has no encoding to mend
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    sys.stdout, sys.stderr = _Guard(_Watched(out)), _Guard(_Watched(error, silent=True))
    try:
        yield
        sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = out, error


def give_up(stream: TextIO) -> None:
    """Send what is still in the buffers of ``stream`` nowhere: its end is not to fail again."""
    with suppress(OSError, ValueError), open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


class _Watched:
    """A stream whose failures are :class:`OutputLost`, or nothing if ``silent``."""

    def __init__(self, stream: TextIO, silent: bool = False):
        self._stream, self._silent = stream, silent

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """See :meth:`io.TextIOBase.write`."""
        with self._failures():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """See :meth:`io.TextIOBase.flush`."""
        with self._failures():
            self._stream.flush()

    @contextmanager
    def _failures(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if not self._silent:
                raise OutputLost(error.strerror or str(error)) from error


class _Guard(_Watched):
    """The same, of printable text. Rich writes past it: its own sequences are meant."""

    @property
    def rich_proxied_file(self) -> Any:
        """Where consoles of Rich write to."""
        return self._stream

    def write(self, text: str) -> int:
        """See :meth:`io.TextIOBase.write`."""
        self._stream.write(printable(text))
        return len(text)

    def flush(self) -> None:
        """See :meth:`io.TextIOBase.flush`."""
        self._stream.flush()
