"""``python -m harness.store.publish FROM TO``: a compact copy of results, to be kept with the code.

Planned trials with their records and raw arrays, and the images of some materials; not the states
of fitted methods, which are large and can be fitted again, nor trials of earlier plans.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from harness.store import code, files
from harness.store.database import FILE
from harness.store.folder import ResultsFolder
from harness.store.lock import LOCK, claim, locked
from harness.store.stored import STATE

_PICTURES = ("target", "pdf")
"""Arrays of the measure ``slices`` that are drawn and that no number is made of."""


def publish(source: Path, target: Path, pictured: Collection[str] = ()) -> int:
    """Copy the planned trials of ``source`` to ``target``; how many there are.

    Images, and the densities that are drawn, are those of the ``pictured`` materials.

    Results in ``target`` are replaced once the copy is whole; what else is there stays.

    Raises:
        InputError: ``source`` holds no results, or ``target`` holds something else.
    """
    claim(target)
    fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        count = _copy(source, fresh, pictured)
        with locked(target):
            for name in (FILE, files.FOLDER, "suite.yaml"):
                _replace(fresh / name, target / name)
        (target / LOCK).unlink()
    finally:
        shutil.rmtree(fresh)
    return count


def _replace(fresh: Path, old: Path) -> None:
    """Put what is fresh, if anything, in the place of a file or folder of ours."""
    if old.is_dir():
        shutil.rmtree(old)
    if fresh.exists():
        os.replace(fresh, old)


def _copy(source: Path, fresh: Path, pictured: Collection[str]) -> int:
    with ResultsFolder(source) as old, locked(fresh), ResultsFolder(fresh, write=True) as new:
        plan, trials = old.plan(), old.trials()
        new.write_plan({k: v for k, v in plan.items() if k != "trials"}, plan["trials"])
        wanted = [
            t for k in dict.fromkeys(r["trial"] for r in plan["trials"]) if (t := trials.get(k))
        ]
        for trial in wanted:
            shown = trial.labels["material"] in pictured
            kept = {n: d for n, d in trial.files.items() if shown and n != STATE}
            for name, digest in kept.items():
                place = files.place(fresh, name, digest)
                place.parent.mkdir(exist_ok=True)
                shutil.copyfile(files.checked(source, name, digest), place)
            arrays = old.arrays(trial.hash)
            if trial.labels["measure"] == "slices" and not shown:
                arrays = {n: a for n, a in arrays.items() if n not in _PICTURES}
            new.save(replace(trial, folder=fresh), arrays, kept)
        digests = {digest for trial in wanted for digest in trial.parts.values()}
        code.note_units(new, {d: units for d in digests if (units := code.units(old, d))})
        for change in code.equivalents(old):
            code.note_equivalent(new, *change)
        for (part, digest), about in code.probes(old).items():
            if digest in digests:
                code.save_probe(new, part, digest, *about, code.probe(old, part, digest))
        new.compact()
    shutil.copyfile(source / "suite.yaml", fresh / "suite.yaml")
    return len(wanted)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="a folder that harness run wrote")
    parser.add_argument("target", type=Path, help="where the copy goes")
    parser.add_argument("--pictures", default="", help="materials whose images go along: A,B")
    arguments = parser.parse_args()
    pictured = [name for name in arguments.pictures.split(",") if name]
    count = publish(arguments.source, arguments.target, pictured)
    total = sum(p.stat().st_size for p in arguments.target.rglob("*") if p.is_file())
    print(f"{arguments.target}: {count} trials, {total / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
