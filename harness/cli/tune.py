"""``harness tune SUITE.yaml``: the best form of each method at equal fitting seconds."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from harness.cli.suites import Device, Profile, Suite

_MARK = "# Written by: harness tune"
"""Begins a file of this command."""


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def tune(
        suite: Suite,
        material: Annotated[
            str, typer.Option(help="Materials to tune on, as A,B; by default the suite's first.")
        ] = "",
        trials: Annotated[int, typer.Option(min=1, help="Forms tried of each method.")] = 8,
        seconds: Annotated[float, typer.Option(min=0.01, help="Of each fit.")] = 10.0,
        out: Annotated[
            Path | None, typer.Option(help="The file to write; by default the suite's 'tuned'.")
        ] = None,
        profile: Profile = None,
        device: Device = "cpu",
    ) -> None:
        """Try forms of each method, all fitted for the same time, and write the best to a file.

        The forms are random values of a method's knobs and forms, the one in the suite first. The
        best has the lowest KL on conditions that no fit sees, in the mean over the materials of
        its logarithm.
        """
        import yaml

        from harness.cli.suites import planned
        from harness.core import machine
        from harness.core.jsonfile import write_text
        from harness.core.outputs import file_to_write
        from harness.core.protocol.errors import InputError, nearest
        from harness.runner import tuning
        from harness.suite.load import load
        from harness.suite.trials import FIT

        loaded = load(suite, tuned=False)
        target = out or (loaded.path.parent / loaded.suite.tuned if loaded.suite.tuned else None)
        if target is None:
            raise InputError(f"{suite}: names no file under 'tuned'; expected --out FILE")
        file_to_write(target, "--out", _of_tune, "a file of harness tune")
        plan = planned(loaded, profile, device)
        known = plan.labels("material")
        wanted = material.split(",") if material else known[:1]
        for name in wanted:
            if name not in known:
                raise InputError(f"--material {name}: not in {suite}{nearest(name, known)}")
        first = min(t.seed for t in plan.trials if t.measure == FIT)
        fits = [
            t for t in plan.trials
            if t.measure == FIT and t.seed == first and t.material in wanted
        ]  # fmt: skip
        say = partial(print, flush=True)
        found = tuning.tune(fits, plan.resolved.material, trials, seconds, say)
        data = {
            "suite": plan.suite,
            "seconds": seconds,
            "trials": trials,
            "materials": wanted,
            "budget": {k: getattr(fits[0].budget, k) for k in ("conditions", "directions", "pool")},
            "machine": machine.describe(device)["machine"],
            "methods": {
                method: {
                    "params": tried[0].params,
                    "tried": [one.as_data() for one in tried],
                }
                for method, tried in found.items()
            },
        }
        text = yaml.safe_dump(data, sort_keys=False, width=100, default_flow_style=None)
        write_text(target, f"{_MARK} {plan.suite}\n{text.rstrip()}")
        print(f"{target}: the best of {trials} forms of {len(found)} methods")


def _of_tune(path: Path) -> bool:
    with path.open(encoding="utf-8") as file:
        return file.read(len(_MARK)) == _MARK
