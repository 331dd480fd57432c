"""``python -m harness.store.publish FROM TO``: a compact copy of results, to be kept with the code.

Planned trials with their records and raw arrays, and the images of some materials; not the states
of fitted methods, which are large and can be fitted again, nor trials of earlier plans, nor what
takes much room: of the large images of ``pictures`` those of a few methods, to two digits. Long
arrays are kept to one in eight thousand, records to nine. The database is one compressed file
(:mod:`harness.store.whole`); of long arrays of probes it has what is compared.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Collection
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from harness.core.paths import ROOT
from harness.identity.small import thinned
from harness.store import code, files, whole
from harness.store.database import FILE, connect, make_tables, transaction
from harness.store.folder import ResultsFolder
from harness.store.lock import LOCK, claim, locked
from harness.store.packing import plain, plain_array, unpack
from harness.store.stored import STATE, Stored

_PICTURES = ("target", "pdf", "samples")
"""Arrays of the measure ``slices`` that are drawn and that no number is made of."""
_LARGE = "pictures"
"""The measure whose images would be most of the copy: 300 KB each, 190 KB rounded."""
_IMAGE_BITS = 23 - 5
"""Bits of the significands of large images, of 23, that are rounded away: what is left is finer
than their noise."""
_LONG, _BITS, _PICTURE_BITS = 32, 11, 13
"""Numbers of an array that is long; bits of their significands, of 23, that are rounded away, and
of pictures, where one in two thousand cannot be seen."""
_DIGITS = 9
"""Of the numbers of a record."""


def publish(
    source: Path, target: Path, pictured: Collection[str] = (), large: Collection[str] = ()
) -> int:
    """Copy the planned trials of ``source`` to ``target``; how many there are.

    Images are those of what is ``pictured``, MATERIAL or MATERIAL/SCENE. Where the measure
    ``pictures`` made large ones, those of the methods ``large`` go along and no smaller ones. The
    densities that are drawn are those of its materials.

    Results in ``target`` are replaced once the copy is whole; what else is there stays.

    Raises:
        InputError: ``source`` holds no results, or ``target`` holds something else.
    """
    claim(target)
    fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        count = _copy(source, fresh, pictured, large)
        with locked(target):
            for name in (whole.WHOLE, FILE, files.FOLDER, "suite.yaml"):
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
    else:
        old.unlink(missing_ok=True)


def _copy(source: Path, fresh: Path, pictured: Collection[str], large: Collection[str]) -> int:
    with ResultsFolder(source) as old, locked(fresh), ResultsFolder(fresh, write=True) as new:
        plan, trials = old.plan(), old.trials()
        new.write_plan(_about(plan), plan["trials"])
        wanted = [
            t for k in dict.fromkeys(r["trial"] for r in plan["trials"]) if (t := trials.get(k))
        ]
        enlarged = {_cell(t) for t in wanted if t.labels["measure"] == _LARGE and t.files}
        for trial in wanted:
            material, scene = _cell(trial)
            shown = material in {name.partition("/")[0] for name in pictured}
            kept = {}
            if {material, f"{material}/{scene}"} & set(pictured):
                kept = _images(source, fresh, trial, large, _cell(trial) in enlarged)
            arrays = old.arrays(trial.hash)
            drawn = _PICTURES if trial.labels["measure"] == "slices" else ()
            if not shown:
                arrays = {n: a for n, a in arrays.items() if n not in drawn}
            arrays = {
                name: rounded(array, _PICTURE_BITS if name in drawn else _BITS)
                for name, array in arrays.items()
            }
            copy = replace(trial, records=_short(trial), traceback=_placeless(trial), folder=fresh)
            new.save(copy, arrays, kept)
        digests = {digest for trial in wanted for digest in trial.parts.values()}
        code.note_units(new, {d: units for d in digests if (units := code.units(old, d))})
        for change in code.equivalents(old):
            code.note_equivalent(new, *change)
        for (part, digest), about in code.probes(old).items():
            if digest in digests:
                code.save_probe(new, part, digest, *about, thinned(code.probe(old, part, digest)))
    _in_one_piece(fresh)
    shutil.copyfile(source / "suite.yaml", fresh / "suite.yaml")
    return len(wanted)


def _about(plan: dict[str, Any]) -> dict[str, Any]:
    """The plan but for its trials, and for files outside of the code, which are one machine's."""
    about = {k: v for k, v in plan.items() if k != "trials"}
    if "files" in about:
        about["files"] = {
            kind: {label: _inside(found) for label, found in labels.items()}
            for kind, labels in about["files"].items()
        }
    return about


def _inside(found: dict[str, str]) -> dict[str, str]:
    return {name: digest for name, digest in found.items() if not Path(name).is_absolute()}


def _placeless(trial: Stored) -> str:
    """Its traceback, whose files have their places in the code, wherever that lies."""
    return trial.traceback.replace(f"{ROOT}{os.sep}", "")


def _cell(trial: Stored) -> tuple[str, str]:
    return trial.labels["material"], trial.labels["scene"]


def _images(
    source: Path, fresh: Path, trial: Stored, large: Collection[str], enlarged: bool
) -> dict[str, str]:
    """Copy a trial's images; digests by name. Of what is ``enlarged`` there are large ones."""
    kept = {name: digest for name, digest in trial.files.items() if name != STATE}
    if trial.labels["measure"] != _LARGE:
        if enlarged:
            return {}
        for name, digest in kept.items():
            files.keep(fresh, name, files.checked(source, name, digest).read_bytes())
        return kept
    if trial.labels["method"] not in large:
        return {}
    # Its modules take Mitsuba, which a copy without large images does without.
    from harness.mitsuba_runtime import exr

    return {
        name: files.keep(
            fresh,
            name,
            exr.encoded(rounded(exr.read(files.checked(source, name, digest)), _IMAGE_BITS)),
        )
        for name, digest in kept.items()
    }


def _short(trial: Stored) -> list[dict[str, Any]]:
    """Its records, their numbers rounded."""
    numbers = ("value", "ci_low", "ci_high")
    return [r | {key: float(f"{r[key]:.{_DIGITS}g}") for key in numbers} for r in trial.records]


def _in_one_piece(folder: Path) -> None:
    """Compress the database of a folder as a whole; what is like each other stands together."""
    with ResultsFolder(folder) as results:
        places = {
            digest: (trial.labels["measure"], name)
            for trial in results.trials().values()
            for name, digest in trial.kept_arrays.items()
        }
    with closing(connect(folder)) as old, closing(sqlite3.connect(":memory:")) as new:
        new.isolation_level = None
        with transaction(new):
            make_tables(new)
            for table in ("meta", "text", "units", "trial", "probe", "equivalent", "blob"):
                rows = old.execute(f"SELECT * FROM {table}").fetchall()
                if table == "blob":
                    rows.sort(key=lambda row: (places.get(row[0], ("", "")), row[0]))
                for row in rows:
                    form = plain_array if table == "blob" else plain
                    packed = [form(unpack(v)) if isinstance(v, bytes) and v else v for v in row]
                    new.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", packed)
        whole.write(new, folder / whole.WHOLE)
    (folder / FILE).unlink()


def rounded(array: np.ndarray, bits: int = _BITS) -> np.ndarray:
    """A long array of floats, ``bits`` of 23 of their significands rounded away.

    Relative errors are below 2^(bits - 24), that is 2^-13. Of single precision, where the numbers
    have its range; everything else as it is.
    """
    if array.size < _LONG or array.dtype not in (np.float32, np.float64):
        return array
    size, limits = np.abs(array[np.isfinite(array) & (array != 0)]), np.finfo(np.float32)
    if size.size and not limits.tiny <= size.min() <= size.max() <= limits.max / 2:
        return array
    single = array.astype(np.float32)
    kept = (single.view(np.uint32) + (1 << (bits - 1))) & ~np.uint32((1 << bits) - 1)
    return np.where(np.isfinite(single), kept.view(np.float32), single)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="a folder that harness run wrote")
    parser.add_argument("target", type=Path, help="where the copy goes")
    parser.add_argument(
        "--pictures", default="", help="whose images go along: MATERIAL or MATERIAL/SCENE, as A,B"
    )
    parser.add_argument("--large", default="", help="methods whose large images go along, as A,B")
    arguments = parser.parse_args()
    pictured, large = (
        [name for name in given.split(",") if name]
        for given in (arguments.pictures, arguments.large)
    )
    count = publish(arguments.source, arguments.target, pictured, large)
    total = sum(p.stat().st_size for p in arguments.target.rglob("*") if p.is_file())
    print(f"{arguments.target}: {count} trials, {total / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
