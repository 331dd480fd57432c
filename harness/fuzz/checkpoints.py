"""Spoiled files of materials and fits: neural networks, pickles, arrays, measured tables."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random

from harness.fuzz import mutations
from harness.fuzz.attempt import Fuzz
from harness.fuzz.pickles import pickled
from harness.fuzz.whole_files import written
from harness.materials import nbrdf
from harness.materials import registry as materials
from harness.runner import preflight, shipped

_SIZES = (-1, 0, 1, 2, 3, 5, 1000, 10**6, 2**31, 2**40, 2**63, 2**200, 1.5, "4", None, True, [], {})


class Checkpoints(Fuzz):
    """Each is made a material of, which is evaluated at a few directions; or taken for a fit."""

    def __init__(self, folder: Path):
        super().__init__(folder)
        preflight.ready("cpu")
        whole = folder / "whole"
        whole.mkdir()
        self.files = written(whole)
        self.kinds: list[tuple[str, Callable[[Random], dict[str, bytes]]]] = [
            ("neural", lambda rng: {"a.safetensors": self._safetensors(rng)}),
            ("neural", lambda rng: {"a.ckpt": self._zip(rng)}),
            ("neural", lambda rng: {"a.ckpt": pickled(rng)}),
            ("nbrdf", self._arrays),
            ("measured", lambda rng: {"a.bsdf": mutations.damaged(self.files["a.bsdf"], rng)}),
            ("btf", lambda rng: {"a.btf": mutations.damaged(self.files["a.btf"], rng)}),
            ("fit", lambda rng: {"a.safetensors": self._safetensors(rng, "fit.safetensors")}),
        ]
        if "a.h5" in self.files:
            self.kinds.append(
                ("nbrdf", lambda rng: {"a.h5": mutations.damaged(self.files["a.h5"], rng)})
            )

    def attempt(self, rng: Random) -> None:
        """See :class:`Fuzz`."""
        kind, spoil = rng.choice(self.kinds)
        found = spoil(rng)
        for name, content in found.items():
            (self.folder / name).write_bytes(content)
        path = self.folder / next(iter(found))
        if kind == "fit":
            shipped.load(path)
            return
        spec = {"name": "spoiled", "type": kind, "file": str(path)}
        materials.identity(spec)
        if rng.random() < 0.5 or kind != "measured":  # Mitsuba's own reader takes its time
            materials.make_tested(spec)

    def _safetensors(self, rng: Random, name: str = "a.safetensors") -> bytes:
        data = self.files[name]
        if rng.random() < 0.4:
            return mutations.damaged(data, rng)
        (length,) = struct.unpack("<Q", data[:8])
        head, body = json.loads(data[8 : 8 + length]), data[8 + length :]
        kind = rng.randrange(5)
        if kind == 0:
            text = json.dumps(mutations.spoiled(head, rng))
        elif kind == 1:
            about = head["__metadata__"]
            key = rng.choice(sorted(about))
            deep = "[" * 10**5 + "]" * 10**5
            about[key] = rng.choice((deep, "{}", "[]", "nan", '{"a":1}', "\0", json.dumps(deep)))
            text = json.dumps(head)
        elif kind == 2 and "architecture" in head["__metadata__"]:
            about = json.loads(head["__metadata__"]["architecture"])
            about[rng.choice(sorted(about))] = rng.choice(_SIZES)
            head["__metadata__"]["architecture"] = json.dumps(about)
            text = json.dumps(head)
        elif kind == 3:
            text = rng.choice(("[" * 10**6, '{"a":' * 10**5, "{" + '"a":1,' * 10**5 + '"a":1}', ""))
        else:
            entry = head[rng.choice([key for key in head if key != "__metadata__"])]
            entry["shape"] = [rng.choice([s for s in _SIZES if isinstance(s, int)]) for _ in "ab"]
            if rng.random() < 0.5:
                entry["data_offsets"] = [0, rng.choice((0, 4, 2**40, 2**63))]
            text = json.dumps(head)
        raw = text.encode("utf-8", "replace")
        size = rng.choice((len(raw), len(raw), len(raw), 2**63, 2**40, 10**8, 0, len(raw) - 1))
        return struct.pack("<Q", size % 2**64) + raw + body

    def _zip(self, rng: Random) -> bytes:
        """The archive of torch.save: its bytes, or its members rewritten."""
        data = self.files["a.ckpt"]
        if rng.random() < 0.4:
            return mutations.damaged(data, rng)
        out = io.BytesIO()
        kind = rng.randrange(4)
        way = zipfile.ZIP_DEFLATED if kind == 0 else zipfile.ZIP_STORED
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", way) as new:
            names = old.namelist()
            odd = rng.choice(names)
            for name in names:
                content = old.read(name)
                if name == odd and kind == 0:
                    content = bytes(rng.choice((10**6, 3 * 10**8)))  # a bomb
                elif (name == odd or name.endswith("data.pkl")) and kind < 3:
                    content = mutations.damaged(content, rng)
                elif name == odd:
                    continue
                new.writestr(name, content)
                if name == odd and rng.random() < 0.1:
                    new.writestr(f"{name}/../data.pkl", content)
        return out.getvalue()

    def _arrays(self, rng: Random) -> dict[str, bytes]:
        found = {f"a_{key}.npy": self.files[f"a_{key}.npy"] for key in nbrdf.SHAPES}
        odd = rng.choice(sorted(found))
        if rng.random() < 0.5:
            found[odd] = mutations.damaged(found[odd], rng)
        else:
            shape = tuple(
                rng.choice((0, 1, 21, 10**6, 10**12, 2**62)) for _ in range(rng.randrange(4))
            )
            kind = rng.choice(("<f4", "<f8", "|O", "<c16", "|S9999999", "<U2000000000", "|b1", "x"))
            text = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape!r}, }}"
            if rng.random() < 0.2:
                text = "(" * 5000 + text + ")" * 5000
            raw = text.encode() + b"\n"
            found[odd] = b"\x93NUMPY\x02\0" + struct.pack("<I", len(raw)) + raw + bytes(4096)
        return found
