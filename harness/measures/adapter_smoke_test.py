"""Does an adapter keep the protocol at all? Asked once, before anything is measured with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Method
from harness.mitsuba_runtime.variant import current

ROWS = 64


class BadAdapter(Exception):
    """An adapter's answer that no measure could use; names the method and what was wrong."""


def smoke_test(method: Method, material: Material, generator: torch.Generator, device: str) -> None:
    """Raise :class:`BadAdapter` unless ``sample`` and ``pdf`` give tensors of the right kind.

    A few rows only: shapes, types, finite and non-negative densities. Whether the numbers
    are right is the business of ``harness check``.
    """
    condition = material.conditions(ROWS, generator, device)
    u = torch.rand(ROWS, 3, generator=generator).to(device)
    drawn = _call(method, "sample", method.sample, condition, u)
    if not (isinstance(drawn, tuple) and len(drawn) == 2):
        raise BadAdapter(f"{method.name}: sample returned {_kind(drawn)}, expected a DiskSample")
    sample = DiskSample(*drawn)
    _check(method, "sample's wo", sample.wo, (ROWS, 2), signed=True)
    _check(method, "sample's pdf", sample.pdf, (ROWS,))
    _check(method, "pdf", _call(method, "pdf", method.pdf, condition, sample.wo), (ROWS,))


def state_of(method: Method) -> dict[str, Tensor]:
    """The method's state, on the device of this process's materials, to be loaded again there.

    Raises:
        BadAdapter: it is no dict of named tensors.
    """
    state = _call(method, "state_dict", method.state_dict)
    if not isinstance(state, dict):
        raise BadAdapter(f"{method.name}: state_dict returned {_kind(state)}, expected a dict")
    for key, value in state.items():
        if not isinstance(key, str) or not isinstance(value, Tensor):
            raise BadAdapter(
                f"{method.name}: state_dict()[{key!r}] is {_kind(value)}, expected a tensor"
            )
    return {key: value.to(current()) for key, value in state.items()}


def _call(method: Method, what: str, function: Callable[..., Any], *args: Any) -> Any:
    try:
        with torch.inference_mode():
            return function(*args)
    except Exception as error:
        raise BadAdapter(f"{method.name}: {what} raised {type(error).__name__}: {error}") from error


def _check(
    method: Method, what: str, value: Any, shape: tuple[int, ...], signed: bool = False
) -> None:
    name = method.name
    if not isinstance(value, Tensor):
        raise BadAdapter(f"{name}: {what} is {_kind(value)}, expected a tensor")
    if tuple(value.shape) != shape:
        raise BadAdapter(f"{name}: {what} has shape {list(value.shape)}, expected {list(shape)}")
    if not value.is_floating_point():
        raise BadAdapter(f"{name}: {what} has type {value.dtype}, expected floating point")
    bad = int((~value.isfinite()).reshape(ROWS, -1).any(1).sum())
    if bad:
        raise BadAdapter(f"{name}: {what} is not finite in {bad} of {ROWS} rows")
    if not signed and bool((value < 0).any()):
        raise BadAdapter(f"{name}: {what} is negative in {int((value < 0).sum())} of {ROWS} rows")


def _kind(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"a tensor of shape {list(value.shape)}"
    return f"a {type(value).__name__}"
