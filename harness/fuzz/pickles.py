"""Archives of torch.save with pickles of our own making in them."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
from random import Random
from types import SimpleNamespace
from typing import Any

import torch

from harness.fuzz import mutations


class _Odd:
    """Pickled as a call with arguments of our choice."""

    def __init__(self, *call: Any):
        self.call = call

    def __reduce__(self) -> Any:
        return self.call


def pickled(rng: Random) -> bytes:
    """An archive with a pickle of its own making."""
    big = rng.choice((10, 10**9, 10**12, 2**62, -1))
    storage_of = ("storage", torch.FloatStorage, "0", "cpu", 16)
    rebuild = torch._utils._rebuild_tensor_v2

    class Pickler(pickle.Pickler):
        def persistent_id(self, item: Any) -> Any:
            return storage_of if isinstance(item, SimpleNamespace) else None

    one = _Odd(rebuild, (SimpleNamespace(), 0, (big, 1), (0, 0), False, {}))
    same = _Odd(rebuild, (SimpleNamespace(), 0, (4, 4), (4, 1), False, {}))
    content: Any = rng.choice(
        (
            {"a": one},
            {str(i): same for i in range(3000)},
            {"state_dict": {"rgb_texture": same, "offset_texture": same}},
            {"rgb_texture": same, "rgb_network.layers.x.weight": same},
            {"rgb_texture": same, "offset_texture": same, "rgb_network.layers.99999.weight": same},
            mutations.deep(200, rng),
            _Odd(print, ("a pickle was run",)),
            [_Odd(dict, ([("a", 1)],)), _Odd(list, ("abc",))],
            {"a": _Odd(getattr, ("text", "upper"))},
        )
    )  # fmt: skip
    out, raw = io.BytesIO(), io.BytesIO()
    Pickler(raw, protocol=2).dump(content)
    data = raw.getvalue()
    kind = rng.randrange(4)
    if kind == 0:
        data = mutations.damaged(data, rng)
    elif kind == 1:
        data = rng.choice(
            (
                b"\x80\x04\x8d" + struct.pack("<Q", 2**62),
                b"\x80\x04\x95" + struct.pack("<Q", 2**60), b"\x8b" + struct.pack("<i", 10**9),
                b"(" * 10**6, b"]" + b"0]" * 10**6 + b".", b"r\xff\xff\xff\x7f", b"}" * 10,
                b"]" * 10**6 + b"a" * (10**6 - 1) + b".", b"", b".", b"N.",
            )
        )  # fmt: skip
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("archive/data.pkl", data)
        archive.writestr("archive/data/0", bytes(64))
    return out.getvalue()
