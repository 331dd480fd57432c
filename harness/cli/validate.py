"""``harness validate SUITE.yaml``: would it run?"""

from __future__ import annotations

import sys

import typer

from harness.cli.suites import Device, Suite


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command()
    def validate(
        suite: Suite,
        device: Device = "cpu",
    ) -> None:
        """Check every name, key, type, file and adapter of a suite, in all its profiles.

        What the suite describes itself is built once and rendered in 8 x 8 pixels. All mistakes
        are listed.
        """
        from harness.runner.answer_cache import AnswerCache

        answers = AnswerCache({"validate": device}, suite, stored=False)
        if device != "cpu":
            answers.disable()  # a GPU is not looked at
        if said := answers.find():
            print(said["text"])
            return

        from harness.core.protocol.errors import Mistakes
        from harness.runner import preflight, rehearsal
        from harness.suite import made_by
        from harness.suite.load import load
        from harness.suite.plan import make_plan

        preflight.ready(device)
        try:
            loaded = load(suite)
            rehearsal.check(loaded, device)
        except Mistakes as error:
            for line in error.lines:
                print(f"error: {line}", file=sys.stderr)
            raise typer.Exit(2) from None
        lines = []
        for profile in loaded.suite.profiles or (None,):
            plan = make_plan(loaded, profile, device)
            size = " x ".join(
                f"{len(plan.labels(kind))} {kind}s" for kind in ("material", "method", "measure")
            )
            lines.append(
                f"{loaded.path}: {profile or 'no profile'}: {len(plan.trials)} trials ({size})"
            )
        lines += [f"{loaded.path}: {line}" for line in made_by.lines(loaded.left_out)]
        for base in dict.fromkeys(m.swept_from for m in loaded.suite.methods if m.swept_from):
            swept = [
                m.label.removeprefix(f"{base} ")
                for m in loaded.suite.methods
                if m.swept_from == base
            ]
            lines.append(f"{loaded.path}: {base} sweeps {', '.join(swept)}")
        print("\n".join(lines))
        answers.keep({"text": "\n".join(lines)})
