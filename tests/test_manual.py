"""docs/suites.md says what the schemas say, and every number has a meaning."""

from __future__ import annotations

import ast
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from harness.analysis import metrics
from harness.analysis.results import load_results
from harness.core.paths import ROOT
from harness.measures import registry as measures
from harness.mitsuba_runtime import variant
from harness.report.manual.__main__ import MARK, renewed
from harness.report.manual.words import KEYS, SETTINGS
from harness.suite import schema

RECORDS = ROOT / "harness" / "analysis" / "records"


@pytest.fixture(scope="module", autouse=True)
def mitsuba():
    variant.use("cpu")


def test_the_file_is_current():
    """Else: python -m harness.report.manual docs/suites.md."""
    from harness.report.manual.text import manual

    text = (ROOT / "docs" / "suites.md").read_text("utf-8")
    assert MARK in text and renewed(text, manual()) == text


def test_every_key_and_setting_has_its_meaning_and_no_other():
    for name, meanings in KEYS.items():
        assert set(meanings) == set(getattr(schema, name).model_fields), name
    used = {key for name in measures.names() for key in measures.load(name).Settings.model_fields}
    assert used == set(SETTINGS)


def recorded(file: Path) -> set[str]:
    """Names of the records that a file makes, ``*`` for what is put together when it runs."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "Record"):
            continue
        name = node.args[0]
        if isinstance(name, ast.Constant):
            found.add(name.value)
        elif isinstance(name, ast.JoinedStr):
            parts = (v.value if isinstance(v, ast.Constant) else "*" for v in name.values)
            found.add("".join(parts))
    return found


@pytest.mark.parametrize("file", sorted(RECORDS.glob("*.py")), ids=lambda file: file.stem)
def test_every_record_of_the_source_is_a_metric(file: Path):
    for name in recorded(file):
        known = [metric.name for metric in metrics.of_measure(file.stem.replace("_", "-"))]
        assert any(fnmatchcase(k, name) or fnmatchcase(name, k) for k in known), name


def test_metrics_are_of_measures_that_exist_and_are_named_once():
    assert {metric.measure for metric in metrics.METRICS} == set(measures.names())
    names = [(metric.measure, metric.name) for metric in metrics.METRICS]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("suite", ["table2", "table1", "stability", "neumip"])
def test_published_numbers_are_metrics_with_their_units(suite: str):
    table = load_results(ROOT / "results" / "reference" / suite)
    for row in table[["measure", "metric", "unit"]].drop_duplicates().itertuples():
        if row.metric:
            found = metrics.find(row.measure, row.metric)
            assert found and row.unit in (found.unit, ""), row
