"""What the documentation points to is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from harness.cli.main import VERBS

ROOT = Path(__file__).parents[1]
DOCS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
LINK = re.compile(r"(?<!`)\]\((?!https?:)([^)#]*)(#[^)]*)?\)")


def heading(line: str) -> str:
    """The anchor of a heading, as GitHub makes it."""
    text = re.sub(r"[`*]", "", line.lstrip("# ").strip().lower())
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")


@pytest.mark.parametrize("file", DOCS, ids=lambda file: file.name)
def test_links_lead_somewhere(file: Path):
    for path, anchor in LINK.findall(file.read_text("utf-8")):
        target = (file.parent / path).resolve() if path else file
        assert target.exists(), f"{file.name}: {path}"
        if anchor:
            lines = target.read_text("utf-8").splitlines()
            anchors = {"#" + heading(line) for line in lines if line.startswith("#")}
            assert anchor in anchors, f"{file.name}: {path}{anchor}"


@pytest.mark.parametrize("file", DOCS, ids=lambda file: file.name)
def test_files_and_commands_that_are_named_are_there(file: Path):
    text = file.read_text("utf-8")
    for path in re.findall(r"`((?:harness|methods|suites|tests|scripts)/[\w/.-]+)`", text):
        if "NAME" not in path:
            assert (ROOT / path).exists(), f"{file.name}: {path}"
    for verb in re.findall(r"^    (?:scripts/with-env )?harness ([a-z]+)\b", text, re.MULTILINE):
        assert verb in VERBS, f"{file.name}: harness {verb}"


def test_the_readme_is_short_and_its_suite_is_valid():
    text = (ROOT / "README.md").read_text("utf-8")
    assert len(text.splitlines()) < 200
    (block,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    assert {"materials", "methods", "scenes", "measures"} <= set(yaml.safe_load(block))


def test_every_suite_is_listed():
    text = (ROOT / "docs" / "suites.md").read_text("utf-8")
    names = {file.stem for file in (ROOT / "suites").glob("*.yaml")}
    assert names <= set(re.findall(r"`([\w-]+)`", text))
