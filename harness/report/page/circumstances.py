"""Under which circumstances a suite was measured, each said once."""

from __future__ import annotations

from harness.analysis.results import Results
from harness.report.tables.common import machine_words


def facts(results: Results) -> list[str]:
    """How many materials, methods and scenes, and the profile."""
    scenes = [scene for scene in dict.fromkeys(results.frame["scene"]) if scene]
    failed = results.frame.loc[~results.frame["status"].isin(("ok", "stale")), "trial"].nunique()
    said = [
        _count(len(results.materials), "material"),
        _count(len(results.methods), "method"),
        _count(len(scenes), "scene") if scenes else "",
        f"profile {results.profile}" if results.profile else "",
        f"{_count(failed, 'trial')} without a number" if failed else "",
    ]
    return [fact for fact in said if fact]


def circumstances(results: Results) -> list[str]:
    """Environments of the trials, without repetition."""
    found: dict[str, None] = {}
    for trial in dict.fromkeys(results.frame["trial"]):
        for line in _environment(results.stored(trial).environment):
            found[line] = None
    return list(found)


def _environment(environment: dict) -> list[str]:
    lines = []
    machine = machine_words(environment.get("machine", ""))
    if machine:
        device = environment.get("device", "")
        lines.append(f"Machine: {machine}" + (f"; device {device}" if device else ""))
    versions = dict(environment.get("versions") or {})
    if environment.get("python"):
        versions = {"python": environment["python"], **versions}
    if versions:
        said = ", ".join(f"{name} {version or '(none)'}" for name, version in versions.items())
        lines.append(f"Versions: {said}")
    if environment.get("kernels"):
        lines.append(f"Networks on the CPU: {environment['kernels']}")
    return lines


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
