"""Spoiled suites: those that ship, their values, their keys and their text."""

from __future__ import annotations

import json
import os
from pathlib import Path
from random import Random
from typing import Any

import yaml

from harness.core import registry
from harness.core.paths import SUITES
from harness.fuzz import mutations
from harness.fuzz.attempt import Fuzz
from harness.runner import preflight
from harness.suite.load import load, names
from harness.suite.plan import make_plan

_ALIASES = 12


class Suites(Fuzz):
    """Each is loaded, planned and looked through as ``harness validate`` does before it renders."""

    def __init__(self, folder: Path):
        super().__init__(folder)
        preflight.ready("cpu")
        texts = {name: (SUITES / f"{name}.yaml").read_text("utf-8") for name in names()}
        self.texts = [text for _, text in sorted(texts.items())]
        self.data = [yaml.safe_load(text) for text in self.texts]
        os.chdir(SUITES)  # where the files are that they name

    def attempt(self, rng: Random) -> None:
        """See :class:`Fuzz`."""
        path = self.folder / "suite.yaml"
        path.write_bytes(self._content(rng))
        loaded = load(path)
        profiles = [None, *loaded.suite.profiles]
        plan = make_plan(loaded, rng.choice(profiles), "cpu")
        preflight.check_report(plan)
        if rng.random() < 0.1:
            for method in loaded.suite.methods[:3]:
                registry.make(method.name, **method.params)
        str([trial.labels for trial in plan.trials])

    def _content(self, rng: Random) -> bytes:
        which = rng.randrange(len(self.data))
        kind = rng.randrange(12)
        if kind < 7:
            return _written(mutations.spoiled(self.data[which], rng), rng)
        text = self.texts[which]
        if kind < 9:
            return mutations.damaged(text.encode(), rng)
        lines = text.splitlines()
        at = rng.randrange(len(lines))
        if kind == 9:
            lines[at:at] = _bomb(rng)
        elif kind == 10:
            indent = lines[at][: len(lines[at]) - len(lines[at].lstrip())]
            lines.insert(at, indent + _line(rng))
        else:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        return "\n".join(lines).encode("utf-8", "surrogatepass")


def _written(data: Any, rng: Random) -> bytes:
    """As YAML, or as JSON, which is YAML as well and can say what YAML's writer would not."""
    if rng.random() < 0.5:
        return json.dumps(data).encode("utf-8", "surrogatepass")
    try:
        return yaml.safe_dump(data, allow_unicode=rng.random() < 0.5).encode(
            "utf-8", "surrogatepass"
        )
    except (yaml.YAMLError, ValueError):
        return json.dumps(data).encode("utf-8", "surrogatepass")


def _bomb(rng: Random) -> list[str]:
    """A few lines that stand for very many, or for themselves."""
    kind = rng.randrange(4)
    if kind == 0:
        lines = ["bomb0: &b0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
        for i in range(1, _ALIASES):
            lines.append(f"bomb{i}: &b{i} [{', '.join([f'*b{i - 1}'] * 10)}]")
        return lines
    if kind == 1:
        lines = ["bomb0: &b0 {k: 1}"]
        for i in range(1, _ALIASES):
            lines.append(f"bomb{i}: &b{i} {{<<: [{', '.join([f'*b{i - 1}'] * 10)}]}}")
        return lines
    if kind == 2:
        return ["bomb: &b", rng.choice(("  - *b", "  x: *b", "  <<: *b"))]
    depth = rng.choice((50, 500, 20000))
    return [
        "bomb: " + "[" * depth + "]" * depth if rng.random() < 0.5 else "bomb: " + "{a: " * depth
    ]


def _line(rng: Random) -> str:
    return rng.choice(
        (
            "x: !!python/object/apply:os.system [ls]", "x: !!binary aGFsbG8=", "x: 2001-99-99",
            "x: 2001-01-01", "x: !!set {a, b}", "x: 0x" + "f" * 5000, "x: " + "9" * 5000,
            "x: " + "1:" * 2000 + "1", "? [a, b]\n: c", "on: off", "1: 2", "null: 1", "---", "...",
            "%YAML 9.9", "x: \"\\0\\e[2J\"", "x: 'unfinished", "x: &a *a", "<<: [1, 2]", "<<: x",
            "\tx: 1", "- x", "x: y: z", "x: {", "title: \"\\ud800\"", "title: '=1+1'",
            "parameters: {a: .nan}", "parameters: {a: 1}", "baseline: ''", "seeds: []",
            "seeds: [0, 0]", "seeds: [-1]", "tuned: /dev/zero", "tuned: .",
            "resolution: 99999999999", "scenes: [{file: /dev/zero}]",
        )
    )  # fmt: skip
