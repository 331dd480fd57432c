"""How long a method took in a measure elsewhere: what the time left begins with.

Of one machine to another, or of one version of the code to the next, seconds change; that one
method takes a hundred times another's does not. So these say how trials compare, and the trials
of the run itself how fast it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from harness.runner import shipped
from harness.store.stored import Stored
from harness.suite.trials import FIT, Trial

Key = tuple[str, str]
"""A measure, and the label of a method."""


def of(todo: Iterable[Trial], stored: Mapping[str, Stored]) -> dict[Key, float]:
    """Mean seconds of a trial by measure and method: of all that are ``stored``, whether they hold
    or not; of a fit that is to be made also of those that come with the harness."""
    spent: dict[Key, list[float]] = {}
    for found in stored.values():
        if found.status == "ok" and found.seconds:
            key = (found.labels["measure"], found.labels["method"])
            spent.setdefault(key, []).append(found.seconds)
    fitted = {trial.method for trial in todo if trial.measure == FIT}
    for method in sorted(fitted):
        if (FIT, method) not in spent and (found := shipped.seconds(method)):
            spent[FIT, method] = found
    return {key: sum(some) / len(some) for key, some in spent.items()}
