"""Reads published NeuMIP checkpoints (``.ckpt``). Nothing that is pickled in them is executed.

Two forms are known, both of one resolution, with offset:

- a Lightning file: the tensors under ``state_dict``, names with the prefix ``model.``, textures
  ``offset_texture.texture`` and ``rgb_texture.texture``;
- a bare state dict without the prefix, textures ``offset_texture`` and ``rgb_texture``.

Textures are [C, H, W] with v upwards: a lookup there takes 1 - v. The Gaussian blurs that the
release applies at every start (2 texels for the offset's, 0.5 for the features') are applied
once, here. Networks: ``offset_network`` [offset features, wi.xy] -> depth, ``rgb_network``
[wo.xy, wi.xy, features] -> rgb, LeakyReLU of slope 0.01, ReLU at the end.
"""

from __future__ import annotations

from pathlib import Path

from torch import Tensor

from harness.core.protocol.errors import InputError
from harness.materials.neural import restricted_pickle
from harness.materials.neural.architecture import Architecture
from harness.materials.neural.network import NeuralMBTF
from harness.materials.neural.storage import filled

PREFIX = "model."
OFFSET_BLUR = 2.0
FEATURE_BLUR = 0.5


def load(path: Path, where: str = "") -> NeuralMBTF:
    """The network of a published checkpoint, blurred as it is to be used.

    Raises:
        InputError: not such a file, a tensor missing or of another shape.
    """
    where = where or str(path)
    found = restricted_pickle.tensors(path, where)
    state = {key.removeprefix(PREFIX): value for key, value in found.items()}
    features, offset = (_texture(state, name, where) for name in ("rgb_texture", "offset_texture"))
    networks = {
        ours: _layers(state, theirs, where)
        for ours, theirs in (("decoder", "rgb_network"), ("offset.network", "offset_network"))
    }
    width, layers = _sizes(networks["decoder"])
    if _sizes(networks["offset.network"]) != (width, layers):
        raise InputError(f"{where}: expected offset_network and rgb_network of one width and depth")
    architecture = Architecture(
        resolution=features.shape[1],
        channels=features.shape[0],
        offset_resolution=offset.shape[1],
        offset_channels=offset.shape[0],
        width=width,
        layers=layers,
        activation="leaky_relu",
    )
    tensors = {"texture": _table(features), "offset.texture": _table(offset)}
    for ours, layer_list in networks.items():
        for i, (weight, bias) in enumerate(layer_list):
            tensors[f"{ours}.layers.{i}.weight"] = weight
            tensors[f"{ours}.layers.{i}.bias"] = bias
    network = filled(architecture, tensors, where)
    network.bake(FEATURE_BLUR, OFFSET_BLUR)
    return network


def _texture(state: dict[str, Tensor], name: str, where: str) -> Tensor:
    """[C, H, W], square."""
    for key in (f"{name}.texture", name):
        if key in state:
            texture = state[key].float()
            if texture.dim() == 4 and texture.shape[0] == 1:
                texture = texture[0]
            if texture.dim() != 3 or texture.shape[1] != texture.shape[2]:
                raise InputError(
                    f"{where}: tensor '{key}' is {list(texture.shape)}; expected [C, R, R]"
                )
            return texture
    raise InputError(f"{where}: has no tensor '{name}.texture' or '{name}'")


def _table(texture: Tensor) -> Tensor:
    """Rows of texels with v downwards: 1 - v takes texel centres onto texel centres."""
    return texture.flip(1).permute(1, 2, 0).reshape(-1, texture.shape[0]).contiguous()


def _layers(state: dict[str, Tensor], name: str, where: str) -> list[tuple[Tensor, Tensor]]:
    """Weights and biases in order; they are numbered 0, 2, 4, ... for activations between."""
    prefix = f"{name}.layers."
    numbers = sorted(
        {int(key.removeprefix(prefix).split(".")[0]) for key in state if key.startswith(prefix)}
    )
    if len(numbers) < 2:
        raise InputError(f"{where}: has no tensors '{prefix}0.weight', '{prefix}2.weight', ...")
    found = []
    for number in numbers:
        pair = [state.get(f"{prefix}{number}.{kind}") for kind in ("weight", "bias")]
        if pair[0] is None or pair[1] is None or pair[0].dim() != 2:
            raise InputError(f"{where}: expected '{prefix}{number}.weight' and '.bias'")
        found.append((pair[0].float(), pair[1].float()))
    return found


def _sizes(layers: list[tuple[Tensor, Tensor]]) -> tuple[int, int]:
    """Width and number of hidden layers."""
    return layers[0][0].shape[0], len(layers) - 1
