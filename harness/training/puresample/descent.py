"""Adam for some steps, its rate rising shortly and falling as a cosine; and going on with it."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from harness.core.protocol.errors import InputError

Notify = Callable[[str, float], None]
"""``notify(what is being done, share of it)``."""


class UnderWay:
    """A training of several descents, in a file from which it can be gone on with.

    Written some fifty times in each descent and when it ends; the file appears whole or not at all.
    ``labels`` (text and numbers) say what is being trained, and are compared on loading.
    """

    def __init__(self, file: Path, labels: dict[str, Any]):
        self.file, self.labels = file, labels
        self.done: dict[str, float] = {}
        self._loaded: dict[str, Any] | None = None
        self._before, self._since = 0.0, time.perf_counter()

    def load(self, network: nn.Module) -> None:
        """Go on from the file: sets the network's weights and what the next descent starts from.

        Raises:
            InputError: there is no such file, or it is of another training.
        """
        if not self.file.is_file():
            raise InputError(f"--resume: there is no {self.file} to go on from")
        try:
            state = torch.load(self.file, map_location="cpu", weights_only=True)
            found = state["labels"]
        except Exception as error:
            raise InputError(f"{self.file}: cannot be resumed: {type(error).__name__}") from None
        if found != self.labels:
            changed = [k for k in self.labels if found.get(k) != self.labels[k]] or ["labels"]
            raise InputError(
                f"{self.file}: is of another training (its {', '.join(changed)} differs);"
                " remove it, or leave out --resume"
            )
        network.load_state_dict(state["network"])
        self.done, self._loaded, self._before = state["done"], state, state["seconds"]

    @property
    def seconds(self) -> float:
        """Since it was made, and of the training that was gone on with."""
        return self._before + time.perf_counter() - self._since

    @property
    def begun(self) -> set[str]:
        """Descents of which something is stored."""
        return set(self.done) | ({self._loaded["what"]} if self._loaded else set())

    def save(
        self,
        what: str,
        step: int,
        network: nn.Module,
        optimiser: torch.optim.Optimizer,
        random: torch.Generator,
    ) -> None:
        """Where the descent ``what`` is."""
        temporary = self.file.with_name(f".{self.file.name}.{os.getpid()}")
        torch.save(
            {
                "labels": self.labels,
                "seconds": self.seconds,
                "done": self.done,
                "what": what,
                "step": step,
                "network": network.state_dict(),
                "optimiser": optimiser.state_dict(),
                "generator": random.get_state(),
            },
            temporary,
        )
        os.replace(temporary, self.file)

    def resumed(
        self, what: str, optimiser: torch.optim.Optimizer, random: torch.Generator
    ) -> int | None:
        """The step from which ``what`` goes on, both brought there; None if it has ended.

        Descents that draw from one generator follow one another: it is brought to where the last
        of them that was stored left it.
        """
        state = self._loaded
        if state is None or (what != state["what"] and what not in self.done):
            return 0
        if what != state["what"]:
            return None
        random.set_state(state["generator"].cpu())
        if what in self.done:
            return None
        optimiser.load_state_dict(state["optimiser"])
        return state["step"]


def descend(
    loss: Callable[[], Tensor],
    groups: Iterable[tuple[Iterable[Tensor], float]],
    steps: int,
    notify: Notify,
    what: str,
    network: nn.Module | None = None,
    random: torch.Generator | None = None,
    under_way: UnderWay | None = None,
) -> float:
    """``steps`` of Adam on ``loss()``; ``groups`` are (parameters, rate). The last loss.

    With ``under_way`` the state of the ``network`` and of the generator that the loss draws from
    is stored as it goes, and what is stored there already is not done again.

    Raises:
        FloatingPointError: the loss became nan or infinite.
    """
    rates, parts = [], []
    for parameters, rate in groups:
        parts.append({"params": list(parameters)})
        rates.append(rate)
    # A texel is seen by few rows of a batch: nothing may be added to its gradients' mean square.
    optimiser = torch.optim.Adam(parts, betas=(0.9, 0.99), eps=1e-15, fused=True)
    every, rise, value, first = max(1, steps // 50), max(1, steps // 20), math.nan, 0
    if under_way is not None:
        start = under_way.resumed(what, optimiser, random)
        if start is None:
            return under_way.done[what]
        first = start
    for step in range(first, steps):
        share = min((step + 1) / rise, 0.5 * (1 + math.cos(math.pi * step / steps)))
        for group, rate in zip(optimiser.param_groups, rates, strict=True):
            group["lr"] = rate * share
        found = loss()
        optimiser.zero_grad(set_to_none=True)
        found.backward()
        optimiser.step()
        last = step + 1 == steps
        if step % every == 0 or last:
            value = float(found.detach())
            if not math.isfinite(value):
                raise FloatingPointError(f"{what}: loss is {value} at step {step}")
            if under_way is not None:
                if last:
                    under_way.done[what] = value
                under_way.save(what, step + 1, network, optimiser, random)
            notify(f"{what}, loss {value:.4f}", (step + 1) / steps)
    return value
