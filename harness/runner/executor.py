"""Where units of work run. One unit is all that is to be done for one material.

A unit can go to any machine: it needs the plan, the names in it, and a results folder that
the workers share or that is gathered afterwards. Timed measures must have their machine to
themselves (see :func:`harness.runner.machine_lock.machine`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from harness.core.protocol.errors import InputError, nearest
from harness.runner.todo import Unit


class Executor(Protocol):
    """Runs ``work`` on every unit."""

    def run(self, units: Iterable[Unit], work: Callable[[Unit], None]) -> None:
        """Return when all units are done; exceptions of ``work`` end the run."""


class Local:
    """One unit after the other, in this process."""

    def run(self, units: Iterable[Unit], work: Callable[[Unit], None]) -> None:
        """See :class:`Executor`."""
        for unit in units:
            work(unit)


def make(name: str) -> Executor:
    """The executor called ``name``."""
    if name == "dask":
        raise InputError("--executor dask is not there yet; use --executor local")
    if name != "local":
        raise InputError(f"unknown executor '{name}'{nearest(name, ['local', 'dask'])}")
    return Local()
