"""Is a method fast because it is wrong? z-tests of the mean images, taken together."""

from __future__ import annotations

from harness.analysis import numbers
from harness.analysis.bias import LEVEL, MEASURE, Key, corrected_p, deciding_test, undecided
from harness.analysis.power import AIM, detected, weak_tests
from harness.analysis.results import MethodColumn, Results
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import circumstances

ORDER = 50


def bias(results: Results) -> Table | str:
    """Holm-corrected p-values of each method's mean image against the reference."""
    corrected = corrected_p(results)
    if not corrected:
        return f"no trial of the measure {MEASURE} has a bias test that decides"
    sections = []
    for scene in results.scenes(MEASURE):
        rows = [
            Row(material, [_cell(results, corrected, material, m, scene) for m in results.methods])
            for material in results.materials
        ]
        sections.append(Section(scene, rows))
    sections += _powers(results, len(corrected))
    found = sum(p < LEVEL for p in corrected.values())
    said = circumstances(results, MEASURE)
    return Table(
        name="bias",
        title="Bias",
        caption=(
            "p-value of the test of the method's mean image against a long render with light "
            "sampling, by whatever sampler nothing was fitted for has the least variance, after "
            f"Holm's correction over the {len(corrected)} tests of this table. Below {LEVEL:g} "
            f"the method is biased (‡): {found or 'none'} of {len(corrected)}. "
            f"{_looked_again(results)}{_about_power(results)}{said}"
        ).strip(),
        corner="material",
        columns=[method.label for method in results.methods],
        sections=sections,
        measures=(MEASURE,),
    )


def _powers(results: Results, tests: int) -> list[Section]:
    """The power of every test, in numbers."""
    return [
        Section(
            f"{scene}: smallest uniform error of energy found with 95% power [%]",
            [
                Row(each, [_power_cell(results, each, m, scene, tests) for m in results.methods])
                for each in results.materials
            ],
            brief=False,
        )
        for scene in results.scenes(MEASURE)
    ]


def _power_cell(
    results: Results, material: str, method: MethodColumn, scene: str, tests: int
) -> Cell:
    found = detected(results, material, method.label, scene, tests)
    if isinstance(found, str):
        return Cell(missing=found, ceiling=method.ceiling)
    return Cell(100 * found, text=f"{100 * found:.2g}", ceiling=method.ceiling)


def _about_power(results: Results) -> str:
    """How to read it, and which tests fall short of what they are to find."""
    short = weak_tests(results)
    said = (
        "In brackets the power: the smallest uniform relative error of energy that the test finds "
        f"in 95 of 100 cases at {LEVEL:g} over the number of tests. "
    )
    if not short:
        return said
    some = ", ".join(short[:6]) + (f" and {len(short) - 6} others" if len(short) > 6 else "")
    return f"{said}Within the time for it, this is not below {AIM} for {some}. "


def _looked_again(results: Results) -> str:
    rows = results.frame[results.frame["measure"] == MEASURE]
    metrics = rows.pivot_table(index="trial", columns="metric", values="value")
    if not {"bias-p", "first-bias-p"} <= set(metrics.columns):
        return ""
    both = metrics.dropna(subset=["bias-p", "first-bias-p"])
    again = int((both["first-bias-p"] != both["bias-p"]).sum())
    if not again:
        return ""
    return (
        f"{again} differed at first, and {'have' if again > 1 else 'has'} the p-value of new "
        "renders with several times the samples: few may miss what rare heavy ones carry. "
    )


def _cell(
    results: Results, corrected: dict[Key, float], material: str, method: MethodColumn, scene: str
) -> Cell:
    raw = results.number(MEASURE, "bias-p", material, method.label, scene)
    if isinstance(raw, str):
        return Cell(missing=raw, ceiling=method.ceiling)
    if why := undecided(results, material, method.label, scene):
        return Cell(missing=why, ceiling=method.ceiling)
    p = corrected[(material, method.label, scene)]
    warning = ""
    if p < LEVEL:
        said = _said(results, material, method.label, scene)
        warning = f"biased: {method.label} on {material}{said}"
    found = detected(results, material, method.label, scene, len(corrected))
    power = "" if isinstance(found, str) else f" ({100 * found:.2g}%)"
    text = f"{numbers.p_value(p)}{power}"
    return Cell(p, text=text, warning=warning, ceiling=method.ceiling)


def _said(results: Results, material: str, method: str, scene: str) -> str:
    """The score of the very test whose p-value the cell has."""
    found = deciding_test(results, material, method, scene)
    if found is None:
        return ""
    of_seed = f" (seed {found.seed}, of {found.seeds})" if found.seeds > 1 else ""
    return f", z = {numbers.plain(found.z, 1)}{of_seed}"
