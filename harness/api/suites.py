"""Suites run from Python, and what they stored taken up again."""

from __future__ import annotations

import inspect
import io
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from harness.api.sampler import Sampler
from harness.api.subjects import ready
from harness.core.classes import declared
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.method import Method

if TYPE_CHECKING:
    import pandas as pd

    from harness.suite.load import Loaded
    from harness.suite.plan import Plan
    from harness.suite.trials import Trial

SuiteLike = str | os.PathLike[str] | Mapping[str, Any]


def run(
    suite: SuiteLike,
    out: str | os.PathLike[str] | None = None,
    profile: str | None = None,
    only: str | None = None,
    device: str | None = None,
    quiet: bool = False,
) -> pd.DataFrame:
    """Carry out what a suite asks for and is not stored yet; the table of all its numbers.

    ``suite`` is a file, a name (``harness list suites``), or a dictionary of what a file would say
    (docs/suites.md); a method in it may be a class that stands in a file. ``out`` is the results
    folder, by default ``results/NAME`` as for ``harness run``, whose ``profile`` and ``only`` these
    are. Progress goes to the standard error unless ``quiet``.

    Gives what ``harness.load_results(out)`` does: a row per number with its 95 % interval. A trial
    that failed is in it, with its status and reason.

    Raises:
        InputError: the suite is refused.
        KeyboardInterrupt: the run was interrupted; what was measured is stored.
    """
    ready(device)
    from harness.analysis.results import load_results
    from harness.core.terminal import Screen
    from harness.runner.run import INTERRUPTED, Options
    from harness.runner.run import run as carry_out

    plan = _planned(_loaded(suite), profile, device)
    folder = Path(out) if out is not None else Path("results") / plan.suite
    console = Screen(highlight=False, file=io.StringIO() if quiet else sys.stderr)
    if carry_out(plan, folder, Options(only=only), console) == INTERRUPTED:
        raise KeyboardInterrupt
    return load_results(folder)


def load_sampler(
    results: str | os.PathLike[str],
    material: str,
    method: str,
    seed: int | None = None,
    suite: SuiteLike | None = None,
) -> Sampler:
    """The method that a stored trial fitted, with its material; nothing is fitted anew.

    ``material`` and ``method`` are labels of the suite, ``seed`` one of its seeds, by default the
    first. ``suite`` is where the suite is; by default the copy in ``results``, which does for a
    suite that names no files or names them from the working folder.

    Raises:
        InputError: no such trial, another suite, or a fit that ended badly or was not kept.
    """
    from harness.core import registry
    from harness.measures.fit import restore
    from harness.store.folder import ResultsFolder

    folder = Path(results)
    with ResultsFolder(folder) as store:
        head = store.plan()
        device = str(head.get("device") or "cpu")
        loaded = _loaded(suite if suite is not None else folder / "suite.yaml")
        ready(device)
        plan = _planned(loaded, head.get("profile") or None, device)
        fit = _fit(plan, material, method, seed)
        stored = store.trials({fit.hash}).get(fit.hash)
        if stored is None:
            raise InputError(
                f"{folder}: the fit of '{method}' to '{material}' is not stored, or that of another"
                " suite is (suite= says where the suite is)"
            )
        if stored.status != "ok":
            raise InputError(
                f"{folder}: the fit of '{method}' to '{material}' ended as {stored.status}:"
                f" {stored.reason}"
            )
        state = _state(folder, fit, stored)
    target = plan.resolved.material(fit)
    made = restore(registry.make(fit.method_name, **fit.params), target, state)
    return Sampler(target, made, device)


def _state(folder: Path, fit: Trial, stored: Any) -> Any:
    """Tensors of a fit: as stored, or as they came with the harness."""
    from harness.runner import shipped

    if stored.has_state:
        return stored.tensors(fit.budget.device)
    # Published results keep no states; those that came with the harness are still there.
    if path := shipped.find(fit):
        return shipped.load(path)[0].tensors
    raise InputError(f"{folder}: the state of '{fit.method}' was not kept; run the suite again")


def _fit(plan: Plan, material: str, method: str, seed: int | None) -> Trial:
    from harness.suite.trials import FIT

    for key, label in (("material", material), ("method", method)):
        known = plan.labels(key)
        if label not in known:
            raise InputError(f"{plan.where}: no {key} '{label}'{nearest(label, known)}")
    fits = [
        t
        for t in plan.trials
        if (t.measure, t.material, t.method) == (FIT, material, method) and seed in (None, t.seed)
    ]
    if not fits:
        seeds = sorted({str(t.seed) for t in plan.trials})
        raise InputError(f"{plan.where}: no seed {seed}; known: {', '.join(seeds)}")
    return fits[0]


def _planned(loaded: Loaded, profile: str | None, device: str | None) -> Plan:
    from harness.runner import shipped
    from harness.suite.plan import make_plan

    return make_plan(loaded, profile, ready(device), shipped.find)


def _loaded(suite: SuiteLike) -> Loaded:
    from harness.suite.load import from_data, load

    if isinstance(suite, Mapping):
        return from_data({key: _plain(key, value) for key, value in suite.items()})
    return load(os.fspath(suite))


def _plain(key: str, value: Any) -> Any:
    """Classes of methods by their files, tuples as lists; the rest stays."""
    if isinstance(value, tuple):
        value = list(value)
    if key != "methods" or not isinstance(value, list):
        return value
    named = [
        {**item, "name": _named(item["name"])}
        if isinstance(item, Mapping) and "name" in item
        else _named(item)
        for item in value
    ]
    return named


def _named(item: Any) -> Any:
    """``file.py:Class`` of a class; what is none stays."""
    if not (isinstance(item, type) and issubclass(item, Method)):
        return item
    try:
        file = Path(inspect.getfile(item))
    except (OSError, TypeError):  # made in a notebook or at the prompt
        file = Path()
    if item.__qualname__ not in {found.class_name for found in declared(file)}:
        raise InputError(
            f"methods: {item.__name__} stands in no file, so a stored number could not say which"
            " code it is of; write it to one, and name it file.py:Class"
        )
    return f"{file.resolve()}:{item.__qualname__}"
