"""Small files of materials and fits as they should be, to be spoiled."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch

from harness.materials import measured, nbrdf
from harness.materials.neural import storage
from harness.materials.neural.architecture import Architecture
from harness.materials.neural.network import NeuralMBTF
from harness.runner import shipped

_SMALL = Architecture(
    resolution=4, channels=2, offset_resolution=4, offset_channels=2, width=4, layers=2
)


def written(folder: Path) -> dict[str, bytes]:
    """Files of every kind, put into ``folder``: their contents, by name."""
    torch.manual_seed(0)
    network = NeuralMBTF(_SMALL)
    storage.save(folder / "a.safetensors", network, {"name": "spoiled", "about": "small"})
    torch.save(_published(network), folder / "a.ckpt")
    rng = np.random.default_rng(0)
    arrays = {key: rng.random(shape, np.float32) / 8 for key, shape in nbrdf.SHAPES.items()}
    for key, array in arrays.items():
        np.save(folder / f"a_{key}.npy", array)
    _keras(folder / "a.h5", arrays)
    (folder / "a.bsdf").write_bytes(_bsdf())
    (folder / "a.btf").write_bytes(_btf())
    _fit(folder / "fit.safetensors")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def _published(network: NeuralMBTF) -> dict[str, torch.Tensor]:
    """As the checkpoints of NeuMIP name what they hold."""
    state = network.state_dict()
    found = {"rgb_texture": torch.rand(2, 4, 4), "offset_texture": torch.rand(2, 4, 4)}
    for ours, theirs in (("decoder", "rgb_network"), ("offset.network", "offset_network")):
        for key, value in state.items():
            if key.startswith(f"{ours}.layers."):
                number, kind = key.removeprefix(f"{ours}.layers.").split(".")
                found[f"{theirs}.layers.{2 * int(number)}.{kind}"] = value
    return found


def _keras(path: Path, arrays: dict[str, Any]) -> None:
    try:
        import h5py
    except ImportError:
        return  # then such files cannot be read either
    with h5py.File(path, "w") as file:
        for i in (1, 2, 3):
            file[f"layers/dense_{i}/vars/0"] = arrays[f"fc{i}"]
            file[f"layers/dense_{i}/vars/1"] = arrays[f"b{i}"]


def _bsdf() -> bytes:
    """The smallest that Mitsuba reads: isotropic, of few angles."""
    few = np.linspace(0, 1, 4, dtype=np.float32)
    return measured.written(
        {
            "description": np.frombuffer(b"made up", np.uint8),
            "jacobian": np.array([1], np.uint8),
            "phi_i": np.zeros(1, np.float32),
            "theta_i": few * 1.5,
            "ndf": np.ones((4, 4), np.float32),
            "sigma": np.ones((4, 4), np.float32),
            "vndf": np.ones((1, 4, 4, 4), np.float32),
            "luminance": np.ones((1, 4, 4, 4), np.float32),
            "rgb": np.full((1, 4, 3, 4, 4), 0.3, np.float32),
        }
    )


def _btf() -> bytes:
    """Of 4 x 4 directions and 2 x 2 texels."""
    angles = np.array([(0, 0), (1, 0), (1, 2.1), (1, 4.2)], np.float32)
    names = b"".join(struct.pack("<I", 1) + c for c in (b"R", b"G", b"B"))
    rest = bytes(240) + struct.pack("<4f", 5, 1, 1, 1) + struct.pack("<I", 0)
    rest += struct.pack("<I", 3) + b"<a>" + struct.pack("<I", 3) + names
    data = b"!FMF06FC" + struct.pack("<2I", len(rest) + 8, 4) + rest + struct.pack("<I", 4)
    for view in angles:
        data += view.tobytes() + struct.pack("<I", 4) + angles.tobytes()
    data += struct.pack("<2I", 2, 2) + struct.pack("<I", 0)
    data += struct.pack("<B3I", 4, 2, 3 * 16, 4)
    return data + np.full(2 + 3 * 16 * 2 + 4 * 2, 0.5, "<f4").tobytes()


def _fit(path: Path) -> None:
    from safetensors.torch import save_file

    about = {
        "records": [{"metric": "steps", "value": 1.0}],
        "environment": {},
        "started": "",
        "seconds": 1.0,
        "parts": {},
    }
    metadata = {"format": shipped.FORMAT, "fit": "{}", "record": json.dumps(about)}
    save_file({"state.w": torch.rand(3), "array.loss": torch.rand(3)}, path, metadata=metadata)
