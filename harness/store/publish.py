"""``python -m harness.store.publish FROM TO``: a compact copy of results, to be kept with the code.

Planned trials with their records and raw arrays, and the images of some materials; not the states
of fitted methods, which are large and can be fitted again, nor trials of earlier plans, nor what
takes much room and is shown otherwise: the images of ``pictures``. Long arrays are kept to four
digits.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from harness.store import code, files
from harness.store.database import FILE
from harness.store.folder import ResultsFolder
from harness.store.lock import LOCK, claim, locked
from harness.store.stored import STATE

_PICTURES = ("target", "pdf", "samples")
"""Arrays of the measure ``slices`` that are drawn and that no number is made of."""
_LEFT_OUT = {"pictures": "images"}
"""By measure, what would be most of the copy: 300 KB an image."""
_LONG, _BITS = 32, 9
"""Numbers of an array that is long; bits of their significands, of 23, that are rounded away."""


def publish(source: Path, target: Path, pictured: Collection[str] = ()) -> int:
    """Copy the planned trials of ``source`` to ``target``; how many there are.

    Images are those of what is ``pictured``, MATERIAL or MATERIAL/SCENE; the densities that are
    drawn are those of its materials.

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
            material, scene = (trial.labels[label] for label in ("material", "scene"))
            shown = material in {name.partition("/")[0] for name in pictured}
            without = _LEFT_OUT.get(trial.labels["measure"])
            imaged = {material, f"{material}/{scene}"} & set(pictured) and without != "images"
            kept = {n: d for n, d in trial.files.items() if imaged and n != STATE}
            for name, digest in kept.items():
                place = files.place(fresh, name, digest)
                place.parent.mkdir(exist_ok=True)
                shutil.copyfile(files.checked(source, name, digest), place)
            arrays = old.arrays(trial.hash)
            if trial.labels["measure"] == "slices" and not shown:
                arrays = {n: a for n, a in arrays.items() if n not in _PICTURES}
            arrays = {name: rounded(array) for name, array in arrays.items()}
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


def rounded(array: np.ndarray) -> np.ndarray:
    """A long array of floats to the nearest numbers of 15 bits, relative errors below 2^-15.

    Of single precision, where the numbers have its range; everything else as it is.
    """
    if array.size < _LONG or array.dtype not in (np.float32, np.float64):
        return array
    size, limits = np.abs(array[np.isfinite(array) & (array != 0)]), np.finfo(np.float32)
    if size.size and not limits.tiny <= size.min() <= size.max() <= limits.max / 2:
        return array
    single = array.astype(np.float32)
    bits = (single.view(np.uint32) + (1 << (_BITS - 1))) & ~np.uint32((1 << _BITS) - 1)
    return np.where(np.isfinite(single), bits.view(np.float32), single)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="a folder that harness run wrote")
    parser.add_argument("target", type=Path, help="where the copy goes")
    parser.add_argument(
        "--pictures", default="", help="whose images go along: MATERIAL or MATERIAL/SCENE, as A,B"
    )
    arguments = parser.parse_args()
    pictured = [name for name in arguments.pictures.split(",") if name]
    count = publish(arguments.source, arguments.target, pictured)
    total = sum(p.stat().st_size for p in arguments.target.rglob("*") if p.is_file())
    print(f"{arguments.target}: {count} trials, {total / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
