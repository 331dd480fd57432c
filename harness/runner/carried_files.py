"""The files of a run by content: what its specifications name, for machines that do not have them.

Files keep their places to one another below a folder of their own, so that an XML file finds its
meshes and an adapter the modules beside it. What comes with the harness is there already.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from harness.core import registry
from harness.core.paths import ROOT
from harness.identity.named_files import named_in
from harness.runner.task import Task, is_ours
from harness.scenes.named_files import named_files
from harness.suite.plan import Plan
from harness.suite.trials import Trial


@dataclass(frozen=True)
class CarriedFiles:
    """``content`` by absolute path where the run is; ``root`` is the harness's folder there.

    Names that are not absolute are meant from one of ``bases``.
    """

    content: Mapping[str, bytes]
    root: str
    bases: tuple[str, ...]

    @property
    def digest(self) -> str:
        """Of names and content."""
        found = hashlib.sha256(repr((self.root, self.bases)).encode())
        for name, data in sorted(self.content.items()):
            found.update(name.encode() + b"\0" + hashlib.sha256(data).digest())
        return found.hexdigest()[:16]

    def unpack(self, folder: Path) -> None:
        """Write them all below ``folder``."""
        for name, data in self.content.items():
            path = placed(name, folder)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)

    def moved(self, task: Task, folder: Path) -> Task:
        """The task with the names that its files have below ``folder``, and the harness's here."""
        if not self.content and self.root == str(ROOT):
            return task
        return replace(task, trials=tuple(self._trial(trial, folder) for trial in task.trials))

    def _trial(self, trial: Trial, folder: Path) -> Trial:
        def there(text: str) -> str:
            return self._name(text, folder)

        return replace(
            trial,
            material_spec=_changed(trial.material_spec, there),
            scene_spec=_changed(trial.scene_spec, there),
            params=_changed(trial.params, there),
            method_name=there(trial.method_name),
        )

    def _name(self, text: str, folder: Path) -> str:
        file, colon, rest = text.rpartition(":")
        if not (colon and file.endswith(".py")):
            file, colon, rest = text, "", ""
        for base in ("", *self.bases):
            path = str(Path(base, file)) if file and "\0" not in file else file
            if path in self.content:
                return f"{placed(path, folder)}{colon}{rest}"
        if file.startswith(f"{self.root}/"):
            return f"{ROOT}{file[len(self.root) :]}{colon}{rest}"
        return text


def of(plan: Plan) -> CarriedFiles:
    """All files that a plan's trials name and that do not come with the harness."""
    base = Path(plan.where).parent.resolve()
    found: set[Path] = set()
    specs = {repr(x): x for t in plan.trials for x in (t.material_spec, t.scene_spec, t.params)}
    for spec in specs.values():
        found |= {Path(path) for path in named_files(spec, base)}
        found |= {path.absolute() for where in (base, Path()) for path in named_in(spec, where)}
    found |= set(_adapters({trial.method_name for trial in plan.trials}))
    foreign = sorted(path for path in found if not path.is_relative_to(ROOT))
    content = {str(path): path.read_bytes() for path in foreign}
    return CarriedFiles(content, str(ROOT), (str(base), str(Path.cwd())))


def _adapters(names: Iterable[str]) -> Iterator[Path]:
    """Files of adapters, with the modules beside them, which they may import."""
    for name in names:
        if ".py" in name and not is_ours(name):
            file = registry.find(name).file
            yield from (beside for beside in file.parent.glob("*.py") if beside.is_file())


def placed(name: str, folder: Path) -> Path:
    """Where a file of this absolute name is below ``folder``."""
    return folder / Path(name).relative_to("/")


def _changed(value: Any, change: Callable[[str], str]) -> Any:
    """Plain data with every text changed."""
    if isinstance(value, Mapping):
        return {key: _changed(item, change) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_changed(item, change) for item in value]
    return change(value) if isinstance(value, str) else value
