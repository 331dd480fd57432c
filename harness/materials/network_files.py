"""Materials that are networks, as safetensors: tensors, with description and record inside.

One format for each kind of network. Nothing in a file is executed, and no size that it tells is
believed before its tensors have it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor, nn

from harness.core.protocol.errors import InputError

Network = TypeVar("Network", bound=nn.Module)


@dataclass(frozen=True)
class NetworkFiles(Generic[Network]):
    """Files of one kind of network.

    ``format`` stands in the metadata; its number goes up when the same file would mean another f.
    ``architecture`` makes a description of JSON data by ``of(data, where)``, gives it back by
    ``as_dict()``, and counts hidden ``layers``; ``network`` makes a network of a description.
    ``textures`` are tensors that may be stored in half precision: by far the most numbers.
    ``described`` is what messages call the description, ``command`` what writes such files.
    """

    format: str
    architecture: type
    network: type[Network]
    textures: tuple[str, ...]
    command: str
    described: str = "description"

    def save(
        self, path: Path, network: Network, record: dict[str, Any], half_textures: bool = True
    ) -> None:
        """Write ``network`` with its description, and ``record`` of how it came to be (JSON data).

        Textures are rounded to half precision unless told otherwise; the networks stay single.
        """
        from safetensors.torch import save_file

        tensors = {}
        for key, value in network.state_dict().items():
            value = value.detach().cpu().contiguous()
            tensors[key] = value.half() if half_textures and key in self.textures else value.clone()
        metadata = {
            "format": self.format,
            "architecture": json.dumps(network.architecture.as_dict(), sort_keys=True),
            "record": json.dumps(record, sort_keys=True),
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        save_file(tensors, path, metadata=metadata)

    def load(self, path: Path, where: str = "") -> Network:
        """The network in ``path``, in single precision on the CPU.

        Raises:
            InputError: the file is of another kind, or its tensors are not those of its
                description.
        """
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        where = where or str(path)
        data = _json(self.metadata(path, where), "architecture", where)
        architecture = self.architecture.of(data, where)
        try:
            state = load_file(path)
        except (OSError, SafetensorError) as error:
            raise InputError(f"{where}: cannot be read: {error}") from None
        return self.filled(architecture, state, where)

    def filled(self, architecture: Any, state: dict[str, Tensor], where: str) -> Network:
        """A network of that description with those tensors; refuses what does not fit it."""
        # Of the shapes alone: what a description says may be larger than any memory.
        try:
            if architecture.layers > len(state):
                raise RuntimeError("more layers than there are tensors")
            with torch.device("meta"):
                wanted = self.network(architecture).state_dict()
        except (RuntimeError, OverflowError, TypeError) as error:
            said = str(error).partition("\n")[0]
            raise InputError(f"{where}: no network has its {self.described}: {said}") from None
        for key, value in wanted.items():
            if key not in state:
                needed = list(value.shape)
                raise InputError(f"{where}: has no tensor '{key}'; expected it of {needed}")
            if state[key].shape != value.shape:
                found, needed = list(state[key].shape), list(value.shape)
                raise InputError(f"{where}: tensor '{key}' is {found}; expected {needed}")
            if not torch.isfinite(state[key]).all():
                raise InputError(f"{where}: tensor '{key}' holds a value that is not finite")
        owner = self.described + ("'" if self.described.endswith("s") else "'s")
        for key in state:
            if key not in wanted:
                raise InputError(f"{where}: tensor '{key}' is none of its {owner}")
        with torch.random.fork_rng(devices=[]):
            network = self.network(architecture)
        network.load_state_dict({key: value.float() for key, value in state.items()})
        return network.eval()

    def metadata(self, path: Path, where: str = "") -> dict[str, str]:
        """The text stored beside the tensors; nothing else is read."""
        from safetensors import SafetensorError, safe_open

        where = where or str(path)
        try:
            with safe_open(path, framework="pt") as file:
                found = file.metadata() or {}
        except FileNotFoundError:
            raise InputError(f"{where}: no such file: {path.name}") from None
        except (OSError, SafetensorError) as error:
            raise InputError(f"{where}: cannot be read: {error}") from None
        if found.get("format") != self.format:
            raise InputError(
                f"{where}: format is {found.get('format')!r}; expected {self.format!r}, as"
                f" '{self.command}' writes it"
            )
        return found

    def record(self, path: Path) -> dict[str, Any]:
        """How the material came to be, as stored by :meth:`save`."""
        return _json(self.metadata(path), "record", str(path))

    def reflectance_hash(self, path: Path, where: str = "") -> str:
        """SHA-256 of what determines the reflectance: tensors and description, not the record.

        Of the description, what is not the default: a size that is added later, and that a material
        does not use, leaves its hash alone.
        """
        from safetensors import safe_open

        stored = _json(self.metadata(path, where), "architecture", where)
        default = self.architecture().as_dict()
        chosen = {key: value for key, value in stored.items() if value != default.get(key)}
        found = hashlib.sha256(f"{self.format} {json.dumps(chosen, sort_keys=True)}".encode())
        with safe_open(path, framework="pt") as file:
            for key in sorted(file.keys()):
                tensor = file.get_tensor(key).contiguous()
                found.update(f"{key} {list(tensor.shape)} {tensor.dtype}".encode())
                found.update(tensor.view(torch.uint8).numpy().tobytes())
        return found.hexdigest()


def _json(found: dict[str, str], key: str, where: str) -> dict[str, Any]:
    try:
        data = json.loads(found.get(key, ""))
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise InputError(f"{where}: metadata '{key}': expected a JSON mapping")
    return data
