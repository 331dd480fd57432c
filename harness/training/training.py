r"""Fits a neural material to queries: the loop, its schedule, its checkpoints.

The loss is the squared error relative to the prediction,

.. math:: \Big(\frac{v - y}{\mathrm{sg}(\max(v, 0)) + \varepsilon}\Big)^2

with ``sg`` stopping the gradient: noise in y then moves no mean, as a loss of log(1 + y) would.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.errors import InputError
from harness.materials.neural import textures
from harness.materials.neural.network import NeuralMBTF
from harness.training.optimiser import adam
from harness.training.profiles import Profile

_CACHED = 1 << 13
"""Rows whose activations stay in a processor's cache; four times as many take ten times as long."""


@dataclass
class Data:
    """Queries on the device of the training: see ``harness.microgeometry.queries.Queries``."""

    u: Tensor
    kernel: Tensor
    wi: Tensor
    wo: Tensor
    f: Tensor

    def __len__(self) -> int:
        return len(self.u)

    def block(self, first: int, count: int) -> Data:
        """``count`` rows from ``first`` on, around the end. Rows are independent draws."""
        if first + count <= len(self):
            return Data(*(x[first : first + count] for x in vars(self).values()))
        rest = first + count - len(self)
        return Data(*(torch.cat([x[first:], x[:rest]]) for x in vars(self).values()))


class Training:
    """A network under way: ``run`` goes on from ``step``, ``save`` and ``load`` keep all state.

    Two trainings from one seed, interrupted or not, end with the same weights on one machine.
    An offset that was ``taught`` (see ``parallax.py``) stands still while the textures are blurred.
    """

    def __init__(self, profile: Profile, seed: int, device: str = "cpu", taught: bool = False):
        self.profile, self.seed, self.device, self.taught = profile, seed, device, taught
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = NeuralMBTF(profile.architecture).to(device)
        self.optimiser = adam(self._parts().values())
        self.generator = torch.Generator().manual_seed(seed)
        self.step = 0
        self.seconds = 0.0
        self.history: list[float] = []

    def _parts(self) -> dict[tuple[float, bool], list[Tensor]]:
        """Parameters by (rate, whether they are the offset's)."""
        p = self.profile
        parts: dict[tuple[float, bool], list[Tensor]] = {}
        for name, parameter in self.network.named_parameters():
            rate = p.texture_rate if name.endswith("texture") else p.network_rate
            parts.setdefault((rate, name.startswith("offset.")), []).append(parameter)
        return parts

    @property
    def total(self) -> int:
        """Steps of both stages."""
        return self.profile.steps + self.profile.final_steps

    @property
    def blur(self) -> float:
        """Deviation in texels at this step: s0 2^(-t / h), and 0 in the final stage."""
        p = self.profile
        if self.step >= p.steps:
            return 0.0
        first = p.blur * p.architecture.resolution
        return textures.decayed(first, p.halvings, self.step / p.steps)

    def run(
        self, data: Data, notify: Callable[[int, float], None], until: int | None = None
    ) -> None:
        """Steps until ``until`` (the end, if not given).

        ``notify(step, loss)`` is called every hundredth of the whole; what it raises ends the
        run between two steps, and :meth:`save` then stores a state to go on from.

        Raises:
            FloatingPointError: the loss became nan or infinite.
        """
        p, every = self.profile, max(1, self.total // 100)
        until = self.total if until is None else min(until, self.total)
        start = time.perf_counter()
        try:
            while self.step < until:
                final = self.step >= p.steps
                self._set_rates()
                batch = p.final_batch if final else p.batch
                first = int(torch.randint(len(data), (), generator=self.generator))
                value = self.gradient(data.block(first, min(batch, len(data))))
                self.optimiser.step()
                self.step += 1
                if self.step % every == 0 or self.step == until:
                    self.history.append(value)
                    if not math.isfinite(self.history[-1]):
                        raise FloatingPointError(f"loss is {self.history[-1]} at step {self.step}")
                    notify(self.step, self.history[-1])
        finally:
            self.seconds += time.perf_counter() - start

    def gradient(self, batch: Data) -> float:
        """The loss of a batch, and its gradient; a cache's worth of rows at a time on a CPU."""
        self.optimiser.zero_grad(set_to_none=True)
        step = _CACHED if self.device == "cpu" else len(batch)
        total = 0.0
        for first in range(0, len(batch), step):
            part = batch.block(first, min(step, len(batch) - first))
            value = self.loss(part) * (len(part) / len(batch))
            value.backward()
            total += float(value.detach())
        return total

    def loss(self, batch: Data) -> Tensor:
        """The relative squared error of a batch, with the textures blurred as now."""
        a = self.profile.architecture
        level = textures.level_of(batch.kernel, a.resolution) if a.pyramid else None
        sigma = self.blur
        tables = self.network.blurred(sigma) if sigma > 0 else None
        value = self.network(batch.u, batch.wi, batch.wo, level, tables)
        scale = value.detach().clamp(min=0) + self.profile.floor
        return ((value - batch.f) / scale).square().mean()

    def _set_rates(self) -> None:
        p = self.profile
        if self.step < p.steps:
            rise = min(1.0, (self.step + 1) / max(1, p.steps // 50))
            fall = 0.5 * (1 + math.cos(math.pi * self.step / p.steps))
            share = rise * (p.final_share + (1 - p.final_share) * fall)
        else:
            done = (self.step - p.steps) / max(1, p.final_steps)
            share = p.final_share * 0.5 * (1 + math.cos(math.pi * done))
        offset_share = p.offset_share
        if self.taught:
            offset_share = 0.0 if self.step < p.steps else p.taught_share
        for group, (rate, of_offset) in zip(
            self.optimiser.param_groups, self._parts(), strict=True
        ):
            group["lr"] = rate * share * (offset_share if of_offset else 1.0)

    # --- to go on later ------------------------------------------------------------------------

    def save(self, path: Path, labels: dict[str, Any]) -> None:
        """Write everything that :meth:`load` needs; the file appears whole or not at all.

        ``labels`` (text and numbers) say what is being trained, and are compared on loading.
        """
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        torch.save(
            {
                "labels": labels,
                "seed": self.seed,
                "step": self.step,
                "seconds": self.seconds,
                "history": torch.tensor(self.history, dtype=torch.float64),
                "network": self.network.state_dict(),
                "optimiser": self.optimiser.state_dict(),
                "generator": self.generator.get_state(),
            },
            temporary,
        )
        os.replace(temporary, path)

    def load(self, path: Path, labels: dict[str, Any]) -> None:
        """Go on from a file of :meth:`save`; :class:`InputError` if it is of another training."""
        try:
            state = torch.load(path, map_location=self.device, weights_only=True)
            found, seed = state["labels"], state["seed"]
        except Exception as error:
            raise InputError(f"{path}: cannot be resumed: {type(error).__name__}") from None
        if seed != self.seed or found != labels:
            changed = [k for k in labels if found.get(k) != labels[k]] or ["seed"]
            raise InputError(
                f"{path}: is of another training (its {', '.join(changed)} differs);"
                " remove it, or leave out --resume"
            )
        self.step, self.seconds = state["step"], state["seconds"]
        self.history = state["history"].tolist()
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"].cpu())
