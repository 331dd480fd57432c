"""States of the hard cases: what a method's networks may hold, fitted or not.

Each function takes ``(method, generator)``, a fitted method and where randomness comes from,
and gives a complete state as :meth:`Method.state_dict` does, or None where the method has
no such state. The method is left as it is.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator

import torch
from torch import Tensor, nn

from harness.core.protocol.method import Method
from harness.nets.mlp import MLP

State = dict[str, Tensor]
Alter = Callable[[Method, torch.Generator], State | None]

NOISE = 3.0
"""Of the noise on a badly trained tensor, in units of the tensor's own standard deviation."""
LARGE = 50.0
"""An output of a network for which exp is near the ends of single precision."""


def untrained(method: Method, generator: torch.Generator) -> State | None:
    """The state after ``bind`` alone: a fit that was forgotten, or a file that was not found."""
    fresh = _clone(method)
    material, fresh.material = method.material, None
    if material is None or not any(_networks(method)):
        return None
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(_seed(generator))
        fresh.bind(material)
    return fresh.state_dict()


def badly_trained(method: Method, generator: torch.Generator) -> State | None:
    """Every trained tensor under noise three times its own spread: a fit that diverged."""

    def spoil(network: nn.Module) -> None:
        for weight in _trained(network):
            # A lone number has no spread; its size stands in.
            spread = weight.std() if weight.numel() > 1 else weight.abs()
            noise = torch.randn(weight.shape, generator=generator).to(weight)
            weight += NOISE * spread * noise

    return _edited(method, spoil)


def large_outputs(method: Method, generator: torch.Generator) -> State | None:
    """The biases of last layers at +-50, signs at random: a step size that was too large."""

    def enlarge(network: nn.Module) -> None:
        for layer in _last_layers(network):
            sign = torch.randint(2, layer.bias.shape, generator=generator) * 2 - 1
            layer.bias.copy_(LARGE * sign)

    return _edited(method, enlarge)


def bfloat16_weights(method: Method, generator: torch.Generator) -> State | None:
    """Every trained tensor rounded to bfloat16: inference at half the memory."""

    def shorten(network: nn.Module) -> None:
        for weight in _trained(network):
            weight.copy_(weight.bfloat16())

    return _edited(method, shorten)


def extreme(*names: str) -> Alter:
    """The first of ``names`` among :meth:`Method.extremes`: methods name what they have."""

    def alter(method: Method, generator: torch.Generator) -> State | None:
        known = method.extremes()
        return next((known[name] for name in names if name in known), None)

    return alter


def _edited(method: Method, edit: Callable[[nn.Module], None]) -> State | None:
    """The state of a copy whose networks ``edit`` has written to."""
    if not any(_networks(method)):
        return None
    changed = _clone(method)
    with torch.no_grad():
        for _, network in _networks(changed):
            edit(network)
    return changed.state_dict()


def _clone(method: Method) -> Method:
    """A copy with networks of its own; material and tables are shared."""
    clone = copy.copy(method)
    for name, network in _networks(method):
        setattr(clone, name, copy.deepcopy(network))
    return clone


def _networks(method: Method) -> Iterator[tuple[str, nn.Module]]:
    # Tables in a state are no weights: noise on them would make a right adapter wrong.
    return ((k, v) for k, v in vars(method).items() if isinstance(v, nn.Module))


def _trained(network: nn.Module) -> list[nn.Parameter]:
    return [p for p in network.parameters() if p.requires_grad and p.is_floating_point()]


def _last_layers(network: nn.Module) -> list[nn.Linear]:
    """Of every network of ours in it, or else its last linear layer, as far as it has a bias."""
    found = [part.layers[-1] for part in network.modules() if isinstance(part, MLP)]
    if not found:
        found = [part for part in network.modules() if isinstance(part, nn.Linear)][-1:]
    return [layer for layer in found if layer.bias is not None]


def _seed(generator: torch.Generator) -> int:
    return int(torch.randint(1 << 62, (), generator=generator))
