"""Small computations with fixed seeds, kept with a trial and made again when code has changed.

A probe gives arrays. Two of the same thing agree if no number differs by more than a relative
``TOLERANCE``: then the code changed and the numbers did not. Material and method are taken as they
are; nothing is fitted here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from harness.identity.coverage import covered
from harness.identity.tree import Tree, Unit
from harness.identity.tried import tried
from harness.identity.work import recorded

if TYPE_CHECKING:
    from torch import Tensor

Arrays = dict[str, NDArray[Any]]
_NOTES = "notes"

TOLERANCE = 1e-4
"""Largest relative difference of numbers that count as the same."""
SEED = 20_260_301
ROWS = 152
"""Random rows of a probe; those at edges come on top."""
_EDGE_OF_ONE = 1 - 2**-24
_RADII = (0.0, 0.5, 0.98, 0.999, 1 - 1e-6)
"""Of incident directions on the disk, from normal to grazing."""


@dataclass(frozen=True)
class Probe:
    """What a probe gave: numbers, a digest of the ``work`` of it, and the units that it ``tried``.

    ``tried`` are units as in :class:`~harness.identity.digests.SourceDigest`, for which the
    numbers speak: those that ran in every statement and branch, and the values and classes that
    nothing else uses.
    """

    arrays: Mapping[str, NDArray[Any]]
    work: str
    tried: frozenset[str]

    def packed(self) -> Arrays:
        """All of it as arrays, to be stored."""
        notes = json.dumps({"work": self.work, "tried": sorted(self.tried)})
        return {**self.arrays, _NOTES: np.frombuffer(notes.encode(), np.uint8)}

    @classmethod
    def unpacked(cls, arrays: Mapping[str, NDArray[Any]]) -> Probe:
        """Inverse of :meth:`packed`."""
        notes = json.loads(bytes(arrays[_NOTES]))
        rest = {name: value for name, value in arrays.items() if name != _NOTES}
        return cls(rest, notes["work"], frozenset(notes["tried"]))


def probed(
    tree: Tree, units: Mapping[tuple[str, str], Unit], compute: Callable[[], Arrays]
) -> Probe:
    """The probe ``compute`` of code that reaches ``units`` of ``tree``.

    It is run three times: first to compile and load whatever that takes, then for its numbers and
    its work, and once more, slowly, to see which code runs.
    """
    compute()
    with recorded() as work:
        arrays = compute()
    with covered(tree) as coverage:
        compute()
    return Probe(arrays, work.digest, tried(units, coverage.whole))


def difference(
    old: Probe,
    new: Probe,
    old_units: Mapping[str, str],
    new_units: Mapping[str, str],
    timed: bool = False,
) -> str:
    """Why the numbers of a trial may have changed with its code; "" if they have not.

    ``old_units`` and ``new_units`` are the units of the part with their hashes. A unit that is only
    in one of the two has to be among those that the probe of that side tried. A ``timed`` trial
    needs the same work too.
    """
    for probe, here, there in ((new, new_units, old_units), (old, old_units, new_units)):
        known = {(_name(unit), value) for unit, value in there.items()}
        untried = [
            unit
            for unit, value in here.items()
            if (_name(unit), value) not in known and unit not in probe.tried
        ]
        if untried:
            more = f" and {len(untried) - 1} more" if len(untried) > 1 else ""
            return f"{untried[0]}{more} changed, which no probe runs in full"
    if not agree(old.arrays, new.arrays):
        return "the numbers of the probe changed"
    if timed and old.work != new.work:
        return "the work that is timed changed"
    return ""


def _name(unit: str) -> str:
    return unit.rpartition(":")[2]


def agree(first: Mapping[str, NDArray[Any]], second: Mapping[str, NDArray[Any]]) -> bool:
    """Whether two probes gave the same numbers.

    Compared element by element, |a - b| <= TOLERANCE max(|a|, |b|), where the larger of the two is
    at least a millionth of the array's root mean square: rounding may move what is next to nothing.
    Not-a-number and infinity must be in the same places.
    """
    if first.keys() != second.keys():
        return False
    return all(_same(np.asarray(first[name]), np.asarray(second[name])) for name in first)


def _same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    if a.shape != b.shape or a.dtype.kind != b.dtype.kind:
        return False
    if a.dtype.kind not in "fc":
        return bool(np.array_equal(a, b))
    finite = np.isfinite(a)
    if not np.array_equal(finite, np.isfinite(b)):
        return False
    if not np.array_equal(a[~finite], b[~finite], equal_nan=True):
        return False
    x, y = a[finite].astype(np.float64), b[finite].astype(np.float64)
    if not x.size:
        return True
    floor = 1e-6 * math.sqrt(float(np.square(np.maximum(np.abs(x), np.abs(y))).mean()))
    return bool((np.abs(x - y) <= TOLERANCE * np.maximum(np.maximum(abs(x), abs(y)), floor)).all())


def of_material(material: Any, device: str = "cpu") -> Arrays:
    """f and what goes with it, on random and on grazing rows.

    Conditions as the material draws them; ``places`` inside and outside of [0, 1]^2; ``eval``,
    ``target``, ``eval_luminance`` and ``target_grid`` on the disk, on its rim and beyond; ``eval``
    again with none of the material's own effects.
    """
    condition, wo = _rows(material, device)
    found = {
        "conditions": condition,
        "eval": material.eval(condition, wo),
        "target": material.target(condition, wo),
        "luminance": material.eval_luminance(condition, wo),
        "grid": material.target_grid(condition[:8], wo[None, :64]),
        "places": material.places(_places(device)),
    }
    if material.effects:
        plain = material.with_effects(frozenset())
        found["plain"] = plain.eval(condition, wo)
        found["plain places"] = plain.places(_places(device))
    return {name: _numbers(value) for name, value in found.items()}


def of_method(method: Any, material: Any, device: str = "cpu") -> Arrays:
    """Samples, their densities and weights, and the density elsewhere, of a fitted method.

    Uniforms are random, and zero, a half or next to one in every column.
    """
    import torch

    condition, wo = _rows(material, device)
    with torch.inference_mode():
        u = _uniforms(len(condition), device)
        sampled = method.sample(condition, u)
        found = {
            "wo": sampled.wo,
            "pdf": sampled.pdf,
            "pdf elsewhere": method.pdf(condition, wo),
            "size": torch.tensor(method.size_bytes()),
        }
        weighted = method.sample_weighted(condition, u)
        if not method.exact_pdf:  # elsewhere the weight is f/p, which is the material's part
            found |= {"weighted wo": weighted.wo, "weight": weighted.weight}
    return {name: _numbers(value) for name, value in found.items()}


def of_outcome(outcome: Any) -> Arrays:
    """Arrays, images and numbers of what a measure gave for a tiny job."""
    found = {f"array {name}": np.asarray(value) for name, value in outcome.arrays.items()}
    found |= {f"image {name}": np.asarray(value) for name, value in outcome.images.items()}
    found["records"] = np.array([record.value for record in outcome.records], dtype=np.float64)
    found |= {f"state {k}": _numbers(v) for k, v in (outcome.tensors or {}).items()}
    return found


def _rows(material: Any, device: str) -> tuple[Tensor, Tensor]:
    """Conditions [N, C] as the material draws them and at fixed angles, and directions [N, 2]."""
    import torch

    generator = torch.Generator().manual_seed(SEED)
    drawn = material.conditions(ROWS, generator, device)
    fixed = drawn[: 8 * len(_RADII)].clone()
    radius = torch.tensor(_RADII, device=device).repeat_interleave(8)
    angle = torch.arange(len(fixed), device=device) * 2.4
    fixed[:, -2] = radius * angle.cos()
    fixed[:, -1] = radius * angle.sin()
    condition = torch.cat([drawn, fixed])
    r = torch.rand(len(condition), generator=generator).to(device).sqrt()
    r[::8] = 0.9999  # grazing
    r[4::32] = 1.2  # off the disk
    phi = 2 * math.pi * torch.rand(len(condition), generator=generator).to(device)
    # Some next to the mirrored direction, where a peak may be.
    wo = torch.stack([r * phi.cos(), r * phi.sin()], 1)
    wo[1::8] = -condition[1::8, -2:] + 0.01 * wo[1::8]
    return condition, wo


def _uniforms(rows: int, device: str) -> Tensor:
    import torch

    u = torch.rand(rows, 3, generator=torch.Generator().manual_seed(SEED + 1)).to(device)
    for column in range(3):
        for place, value in enumerate((0.0, 0.5, _EDGE_OF_ONE)):
            u[12 * column + 4 * place :: 48, column] = value
    return u


def _places(device: str) -> Tensor:
    """Texture coordinates [N, 2]: random ones in and beyond [0, 1]^2, and corners."""
    import torch

    uv = torch.rand(64, 2, generator=torch.Generator().manual_seed(SEED + 2)) * 3 - 1
    corners = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [_EDGE_OF_ONE, 0.5]])
    return torch.cat([uv, corners]).to(device)


def _numbers(value: Any) -> NDArray[Any]:
    if hasattr(value, "detach"):
        value = value.detach().cpu()
        value = value.float() if str(value.dtype) == "torch.bfloat16" else value
    return np.asarray(value)
