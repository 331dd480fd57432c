"""``harness check``: is this adapter a correct sampler?"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from harness.checks.finding import Finding

STYLES = {"pass": "green", "degraded": "yellow", "fail": "bold red", "skip": "dim"}
_EXPONENT = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+")
SUMMARY = ("passed", "pass"), ("degraded", "degraded"), ("failed", "fail"), ("skipped", "skip")


def check(
    method: Annotated[str, typer.Argument(help="A method's name, or path/to/file.py:Class.")],
    material: Annotated[
        list[str] | None,
        typer.Option(help="Its ordinary cases; repeatable. By default suede and brushed-metal."),
    ] = None,
    case: Annotated[
        list[str] | None, typer.Option(help="A hard case of the catalogue; repeatable.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="The whole catalogue.")] = False,
    property_: Annotated[
        list[str] | None, typer.Option("--property", help="Only this property; repeatable.")
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="A parameter of the constructor; repeatable."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the fit and of all samples.")] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Only failures, and the counts.")
    ] = False,
    mitsuba: Annotated[
        bool, typer.Option("--mitsuba", help="Mitsuba's own chi-square test of the plugin, too.")
    ] = False,
) -> None:
    """Check a method's properties, in ordinary and in hard cases.

    One line for each property and case: pass; degraded (right, but of little use there, with
    the number that says so); FAIL, with the worst input and the command that gives it again;
    or skip. Exit 1 if any fails. A correct adapter fails by chance less than once in a thousand
    runs.
    """
    from harness.checks.plan import carry_out, make_plan
    from harness.core.protocol.errors import InputError, Unsupported
    from harness.core.registry import make
    from harness.core.terminal import Screen
    from harness.mitsuba_runtime import variant

    given = parameters(param or [])
    make(method, **given)  # refuses what cannot be made before anything runs
    plan = make_plan(
        material or (), case or (), property_ or (), everything=everything, mitsuba=mitsuba
    )
    variant.use(device)
    console = Screen(highlight=False, markup=False)
    again = ["harness", "check", method, *(f"--param={item}" for item in param or [])]
    ending = [f"--seed={seed}", f"--device={device}"]
    counts: Counter[str] = Counter()
    unsupported = []
    skipped: set[tuple[str, str, str]] = set()
    for part in plan.parts:
        if not quiet:
            console.print(f"{method} on {part.material}", style="bold", soft_wrap=True)
        try:
            for finding, hard in carry_out(plan, part, make(method, **given), seed, device):
                # What does not apply is said once, not in every case.
                said = (part.material, finding.property, finding.text)
                if finding.verdict == "skip" and said in skipped:
                    continue
                skipped.add(said)
                counts[finding.verdict] += 1
                where = f"--case={hard.name}" if hard else f"--material={part.material}"
                if not hard and not part.ordinary:  # a fit for the sake of hard cases
                    where = f"--case={part.cases[0].name}"
                what = [] if finding.property == "fit" else [f"--property={finding.property}"]
                if not (quiet and finding.ok):
                    show(console, finding, shlex.join([*again, where, *what, *ending]))
        except Unsupported as reason:
            unsupported.append(str(reason))
            counts["skip"] += 1
            if not quiet:
                console.print(f"skip      unsupported: {reason}", style="dim", soft_wrap=True)
    if len(unsupported) == len(plan.parts):
        raise InputError(f"nothing to check: {unsupported[0]}")
    if not counts.total():
        raise InputError(f"nothing to check: no case here has {' or '.join(plan.only)}")
    words = [f"{counts[key]} {word}" for word, key in SUMMARY]
    console.print(", ".join(words), style="red" if counts["fail"] else "bold", soft_wrap=True)
    if counts["fail"]:
        raise typer.Exit(1)


def show(console: Console, finding: Finding, command: str) -> None:
    """The finding on a line; for a failure the worst input and ``command`` on two more."""
    from rich.text import Text

    line = Text(finding.line(), style="dim" if finding.verdict == "skip" else "")
    line.stylize(STYLES[finding.verdict], 0, 8)
    if console.is_terminal and finding.verdict == "pass":
        line.truncate(console.width, overflow="ellipsis")
    console.print(line, soft_wrap=True)
    if not finding.ok:
        if finding.worst:
            console.print(f"          worst: {finding.worst_line()}", soft_wrap=True)
        console.print(f"          again: {command}", soft_wrap=True)


def parameters(given: list[str]) -> dict[str, Any]:
    """``key=value`` as keyword arguments; values are read as in a suite.

    Raises:
        InputError: one is not of that form.
    """
    from harness.core.protocol.errors import InputError
    from harness.core.yamlfile import parse_yaml

    found = {}
    for item in given:
        key, equals, value = item.partition("=")
        if not (equals and key.isidentifier()):
            raise InputError(f"--param {item}: expected KEY=VALUE")
        found[key] = parse_yaml(value, f"--param {item}: expected a value as in a suite")
        if isinstance(found[key], str) and _EXPONENT.fullmatch(found[key]):
            # YAML takes 1e-3 for a text: it wants a point in it.
            found[key] = float(found[key])
    return found


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""
    app.command("check")(check)
