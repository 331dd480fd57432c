"""Small computations with fixed seeds whose numbers tell whether changed code gives others.

Two of the same thing agree if no number differs by more than a relative ``TOLERANCE``. Material and
method are taken as they are; nothing is fitted here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from torch import Tensor

Arrays = dict[str, NDArray[Any]]

TOLERANCE = 1e-4
"""Largest relative difference of numbers that count as the same."""
ROUNDING = 1e-6
"""The same where what follows amplifies it, as training does with its first steps."""
MANY = 512
"""Numbers of an array that are kept where room counts, and compared everywhere."""
_STAGES = (2048, MANY)
"""Copies published before keep the first stage of a long array; the second is taken of that."""
SEED = 20_260_301
ROWS = 152
"""Random rows of a probe; those at edges come on top."""
_EDGE_OF_ONE = 1 - 2**-24
_RADII = (0.0, 0.5, 0.98, 0.999, 1 - 1e-6)
"""Of incident directions on the disk, from normal to grazing."""


def thinned(arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """At most ``MANY`` numbers of an array of floats, evenly spaced, an odd number of places apart.

    Of such arrays, a network's weights, code that changes any changes most. Twice is as once.
    """
    return {name: _thinned(np.asarray(array)) for name, array in arrays.items()}


def _thinned(array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.kind != "f":
        return array
    for most in _STAGES:
        if array.size > most:
            array = array.reshape(-1)[:: math.ceil(array.size / most) | 1]
    return array


def agree(
    first: Mapping[str, NDArray[Any]],
    second: Mapping[str, NDArray[Any]],
    tolerance: float = TOLERANCE,
) -> bool:
    """Whether two probes gave the same numbers.

    Compared element by element, |a - b| <= tolerance max(|a|, |b|), where the larger of the two is
    at least a millionth of the array's root mean square: rounding may move what is next to nothing.
    For a tolerance below that of numbers in general it is the root mean square itself. Not-a-number
    and infinity must be in the same places. Of long arrays as :func:`thinned`.
    """
    first, second = thinned(first), thinned(second)
    if first.keys() != second.keys():
        return False
    return all(_same(array, second[name], tolerance) for name, array in first.items())


def identical(first: Mapping[str, NDArray[Any]], second: Mapping[str, NDArray[Any]]) -> bool:
    """Whether not one bit differs; of long arrays as :func:`thinned`."""
    first, second = thinned(first), thinned(second)
    return first.keys() == second.keys() and all(
        array.tobytes() == second[name].tobytes() for name, array in first.items()
    )


def _same(a: NDArray[Any], b: NDArray[Any], tolerance: float) -> bool:
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
    size = np.maximum(np.abs(x), np.abs(y))
    scale = math.sqrt(float(np.square(size).mean()))
    floor = scale if tolerance < TOLERANCE else 1e-6 * scale
    return bool((np.abs(x - y) <= tolerance * np.maximum(size, floor)).all())


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
    """Arrays, images, numbers and fitted state of what a measure gave for a tiny job."""
    found = {f"array {name}": np.asarray(value) for name, value in outcome.arrays.items()}
    found |= {f"image {name}": np.asarray(value) for name, value in outcome.images.items()}
    found |= {f"state {k}": _numbers(v) for k, v in (outcome.tensors or {}).items()}
    for name, document in outcome.documents.items():
        found[f"document {name}"] = np.array(list(_numbers_in(document)), np.float64)
    if outcome.records:
        found["records"] = np.array([r.value for r in outcome.records], np.float64)
    return found


def _numbers_in(data: Any) -> Iterator[float]:
    """All numbers of JSON data, in its order."""
    if isinstance(data, Mapping):
        data = data.values()
    if isinstance(data, int | float):
        yield float(data)
    elif isinstance(data, Iterable) and not isinstance(data, str):
        for item in data:
            yield from _numbers_in(item)


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
