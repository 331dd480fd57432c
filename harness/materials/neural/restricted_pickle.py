"""The tensors of a PyTorch checkpoint, whatever else is pickled in it.

A pickle is a program that may call any function it can name. This reader resolves only the
names a tensor is made of; every other name becomes a blank that ignores what it is given, so
that a file with foreign objects (hyper-parameters, callbacks, optimisers) can be read without
their code, and without the packages they came from.
"""

from __future__ import annotations

import math
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.errors import InputError

_DTYPES = {
    "FloatStorage": torch.float32,
    "DoubleStorage": torch.float64,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}


class _Blank(dict):
    """In place of every foreign object: takes any state, holds nothing, does nothing.

    A ``dict``, so that pickles of mappings, lists and plain objects can all be replayed on it.
    """

    def __new__(cls, *_: Any, **__: Any) -> _Blank:
        return super().__new__(cls)

    def __init__(self, *_: Any, **__: Any):
        super().__init__()

    def __call__(self, *_: Any, **__: Any) -> _Blank:
        return self

    def __setstate__(self, _: Any) -> None:
        pass

    def __setitem__(self, _key: Any, _value: Any) -> None:
        pass

    def append(self, _: Any) -> None:
        """What a pickled list asks for."""

    def extend(self, _: Any) -> None:
        """What a pickled list asks for."""

    def add(self, _: Any) -> None:
        """What a pickled set asks for."""

    def __hash__(self) -> int:
        return id(self)


class _Reader(pickle.Unpickler):
    """An unpickler that knows tensors, ordered mappings, and nothing else."""

    def __init__(self, file: Any, storage: Callable[[str, torch.dtype], Tensor]):
        super().__init__(file)
        self.storage = storage

    def find_class(self, module: str, name: str) -> Any:
        """See :class:`pickle.Unpickler`; never imports anything."""
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if module == "torch._utils" and name in ("_rebuild_tensor_v2", "_rebuild_tensor"):
            return _rebuild
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return lambda data, *_: data
        if module == "torch" and name in _DTYPES:
            return _DTYPES[name]
        return _Blank

    def persistent_load(self, pid: Any) -> Any:
        """A storage: ("storage", type, key, device, count); always to the CPU."""
        if not (isinstance(pid, tuple) and len(pid) >= 3 and pid[0] == "storage"):
            return _Blank()
        if not isinstance(pid[1], torch.dtype):
            return _Blank()
        return self.storage(str(pid[2]), pid[1])


def _rebuild(storage: Any, offset: Any, size: Any, stride: Any, *_: Any) -> Any:
    """A tensor over a storage; bounds are checked, for the file is not trusted."""
    if not isinstance(storage, Tensor):
        return _Blank()
    numbers = (offset, *size, *stride)
    if any(isinstance(n, bool) or not isinstance(n, int) or n < 0 for n in numbers):
        raise pickle.UnpicklingError("a tensor has a size that is no whole number")
    if len(size) != len(stride):
        raise pickle.UnpicklingError("a tensor has not as many strides as sizes")
    last = offset + sum((n - 1) * s for n, s in zip(size, stride, strict=True) if n)
    if all(size) and last >= len(storage):
        raise pickle.UnpicklingError("a tensor reaches beyond its storage")
    if math.prod(size) > len(storage):
        raise pickle.UnpicklingError("a tensor has more elements than its storage")
    return torch.as_strided(storage, size, stride, offset).clone()


def tensors(path: Path, where: str = "") -> dict[str, Tensor]:
    """All tensors of the state dict in ``path``, by name, on the CPU.

    The state dict is the file's whole content, or what it has under ``state_dict``.

    Raises:
        InputError: no file of that kind (the zip format of torch.save since 1.6), or damaged.
    """
    where = where or str(path)
    try:
        content = _content(path)
    except FileNotFoundError:
        raise InputError(f"{where}: no such file: {path.name}") from None
    except zipfile.BadZipFile:
        raise InputError(
            f"{where}: not a PyTorch checkpoint; expected the zip format of torch.save"
        ) from None
    except Exception as error:
        # Whatever a damaged or hostile pickle makes the reader stumble over.
        raise InputError(f"{where}: cannot be read: {type(error).__name__} {error}") from None
    if isinstance(content, dict) and isinstance(content.get("state_dict"), dict):
        content = content["state_dict"]
    if not isinstance(content, dict):
        raise InputError(f"{where}: holds no state dict")
    found = {k: v for k, v in content.items() if isinstance(k, str) and isinstance(v, Tensor)}
    if not found:
        raise InputError(f"{where}: holds no tensors by name")
    return found


def _content(path: Path) -> Any:
    most = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        # torch.save compresses nothing: what is larger than the file is no checkpoint.
        if sum(member.file_size for member in archive.infolist()) > most:
            raise pickle.UnpicklingError("its members are larger than the file")
        pickles = [name for name in archive.namelist() if name.endswith("data.pkl")]
        if len(pickles) != 1:
            raise zipfile.BadZipFile
        folder = pickles[0].removesuffix("data.pkl")
        known: dict[str, Tensor] = {}

        def storage(key: str, dtype: torch.dtype) -> Tensor:
            if key not in known:
                data = bytearray(archive.read(f"{folder}data/{key}"))
                known[key] = (
                    torch.frombuffer(data, dtype=dtype) if data else torch.empty(0, dtype=dtype)
                )
            return known[key]

        with archive.open(pickles[0]) as file:
            return _Reader(file, storage).load()
