"""``harness check``: is this adapter a correct sampler?"""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

DEFAULT_MATERIALS = ("suede", "brushed-metal")
"""One near-diffuse, one anisotropic and glossy."""


def check(
    method: Annotated[str, typer.Argument(help="A method's name, or path/to/file.py:Class.")],
    material: Annotated[
        list[str] | None,
        typer.Option(
            help=f"A material's name; repeatable. Default: {', '.join(DEFAULT_MATERIALS)}."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the fit and of all samples.")] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    mitsuba: Annotated[
        bool, typer.Option("--mitsuba", help="Mitsuba's own chi-square test of the plugin, too.")
    ] = False,
) -> None:
    """Check a method's properties on materials; one line each, exit 1 if any fails.

    A correct adapter fails by chance less than once in a thousand runs.
    """
    from harness.check import FALSE_ALARM, run_checks
    from harness.check.finding import Finding
    from harness.materials import registry as materials
    from harness.protocol import InputError, Unsupported
    from harness.registry import load, make
    from harness.rendering import variant
    from harness.stats.chisquare import sidak

    load(method)
    names = list(material or DEFAULT_MATERIALS)
    variant.use(device)
    failed = passed = 0

    def show(finding: Finding) -> None:
        nonlocal failed, passed
        failed += not finding.ok
        passed += finding.ok
        typer.echo(finding.line())

    # Materials and the two kinds of test share the false alarms.
    alpha = sidak(FALSE_ALARM, len(names) * (1 + mitsuba))
    skipped = []
    for name in names:
        adapter, subject = make(method), materials.make(name)
        typer.echo(f"{method} on {name}")
        try:
            findings = run_checks(adapter, subject, seed, device=device, alpha=alpha, notify=show)
        except Unsupported as reason:
            typer.echo(f"unsupported: {reason}")
            skipped.append(str(reason))
            continue
        if mitsuba and findings[-1].property != "fit":
            from harness.check.mitsuba_chi2 import mitsuba_chi2

            for finding in mitsuba_chi2(adapter, subject, seed, device=device, alpha=alpha):
                show(finding)
    if len(skipped) == len(names):
        raise InputError(f"nothing to check: {skipped[0]}")
    if failed:
        again = ["harness", "check", method, *(f"--material={n}" for n in names)]
        again += [f"--seed={seed}", f"--device={device}", *(["--mitsuba"] if mitsuba else [])]
        typer.echo(f"{failed} failed, {passed} passed; again: {shlex.join(again)}")
        raise typer.Exit(1)
    typer.echo(f"all {passed} passed")


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""
    app.command("check")(check)
