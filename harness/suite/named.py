"""The files that a plan's materials, methods and scenes name, with the digest of each.

They are in the identity of the trials by content. Kept with the plan by name too, they tell later
whether a file that numbers stand on is another now.
"""

from __future__ import annotations

from pathlib import Path

from harness.core.paths import ROOT
from harness.identity.named_files import digest_of
from harness.scenes.named_files import named_files
from harness.suite.plan import Plan

Named = dict[str, dict[str, dict[str, str]]]
"""By ``material``, ``method`` or ``scene``: by label: digest by file."""


def files_of(plan: Plan) -> Named:
    """All files that the plan's trials name. One that comes with the project is named from its
    root, any other by its whole path."""
    base = Path(plan.where).parent
    found: Named = {"material": {}, "method": {}, "scene": {}}
    for trial in plan.trials:
        for kind, label, look in (
            ("material", trial.material, lambda t=trial: named_files(t.material_spec, base)),
            ("scene", trial.scene, lambda t=trial: named_files(t.scene_spec, base)),
            ("method", trial.method, lambda t=trial: named_files(t.params, base)),
        ):
            if label and label not in found[kind]:
                found[kind][label] = {_shown(p): digest_of([p]).digest for p in look()}
    return {kind: {k: v for k, v in labels.items() if v} for kind, labels in found.items()}


def _shown(path: Path) -> str:
    whole = path.resolve()
    return str(whole.relative_to(ROOT)) if whole.is_relative_to(ROOT) else str(whole)
