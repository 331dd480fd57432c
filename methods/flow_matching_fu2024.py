"""The flows that Fu et al. (2024) trained, read from their release's state dicts."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from harness._methods.flow_matching import FlowMatching
from harness._methods.flow_matching_published import FlowMatchingPublished
from harness.core.columns.bridge import Columns
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Knob
from harness.nets.conditional_flow import ConditionalFlow
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.velocity import Shared

STATES = ("rectify", "diffusion")
QUERIES = ("inverse", "published")
_HIDDEN = ("linear1", "linear2", "linear3", "output")


class FlowMatchingFu2024(FlowMatchingPublished):
    """BSDF Importance Sampling using a Diffusion Model: its networks, and what they sample.

    ``folder`` holds ``MATERIAL_pretrain.pth`` (the base's network 14-16-4) and
    ``MATERIAL_rectify.pth`` or ``MATERIAL_diffusion.pth`` (the velocity's 25-32-32-32-2, without
    biases), by the material's name; ``weights`` says which of the two, rectified as rendered or
    not. The disk's own coordinates, SiLU, four Euler steps. Only tensors are read; nothing is
    fitted. No uniform share, and no sample is dropped for its weight.

    ``query="inverse"`` has :meth:`pdf` invert the steps, ``"published"`` go back by explicit ones.
    Some of the networks fold, and are inverted across folds: in a small share of the samples, which
    the fit's notes give, a step is not one to one, and the density is that of one origin of
    several. So ``exact_pdf`` is false, and estimates are f over the density that sampling has
    accumulated.
    """

    name = "flow-matching-fu2024"
    accumulated = True
    knobs = (Knob("steps", (2, 4, 8, 16), "Euler steps; the networks were fitted for four"),)

    def __init__(
        self,
        folder: str = "fu2024",
        weights: str = "rectify",
        query: str = "inverse",
        steps: int = 4,
    ):
        super().__init__(
            steps=steps,
            base="gaussian",
            width=32,
            layers=3,
            base_width=16,
            reflow=0,
            uniform=0.0,
        )
        for key, value, known in (("weights", weights, STATES), ("query", query, QUERIES)):
            if value not in known:
                raise InputError(f"{self.name}: {key} is '{value}'{nearest(value, known)}")
        self.folder, self.weights, self.query = Path(folder), weights, query
        self.shape |= {"framed": False, "bounded": False, "base_activation": "silu"}

    def back(self, flow: DiscreteFlow, place: Columns, shared: Shared) -> Any:
        """See :meth:`FlowMatching.back`."""
        if self.query == "inverse":
            return FlowMatching.back(self, flow, place, shared)
        return super().back(flow, place, shared)

    def _log_prob(self, net: ConditionalFlow, condition: Tensor, wo: Tensor) -> Tensor:
        if self.query == "inverse":
            return FlowMatching._log_prob(self, net, condition, wo)
        return super()._log_prob(net, condition, wo)

    def refuse_unsteady(self) -> None:
        """Nothing is refused: the networks are another's, and the notes say how they fold."""

    def supports(self, material: Material) -> tuple[bool, str]:
        """Whether there are networks for the material, and it has no features."""
        if material.n_features:
            return False, "networks of the direction alone"
        missing = [f.name for f in self._files(material) if not f.is_file()]
        return not missing, f"no file {missing[0]} in {self.folder}" if missing else ""

    def _files(self, material: Material) -> list[Path]:
        return [self.folder / f"{material.name}_{part}.pth" for part in ("pretrain", self.weights)]

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """Read the networks.

        Raises:
            InputError: a file that is missing, or holds something else.
        """
        self.material = material
        self.module = self.build(material).eval()
        base, velocity = (_tensors(file) for file in self._files(material))
        self.load_state_dict(_converted(self.module, base, velocity, self._files(material)))
        folded = self.measured().folded
        return FitReport(notes=f"{self.weights}: read, not fitted; {folded:.2%} of samples folded")


def _tensors(file: Path) -> dict[str, Tensor]:
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    except (pickle.UnpicklingError, RuntimeError, EOFError):
        raise InputError(f"{file}: not a state dict of tensors alone") from None
    if not isinstance(state, dict) or not all(isinstance(v, Tensor) for v in state.values()):
        raise InputError(f"{file}: not a state dict of tensors alone")
    return state


def _converted(
    net: ConditionalFlow, base: dict[str, Tensor], velocity: dict[str, Tensor], files: list[Path]
) -> dict[str, Tensor]:
    """Their tensors under our names. The base sees the first of the velocity's frequencies alone:
    its weights for the others are zero; and so are the biases that the velocity has not."""
    state = {key: torch.zeros_like(value) for key, value in net.state_dict().items()}
    state |= {k: v for k, v in net.state_dict().items() if k.startswith("encoder.")}
    for i, name in enumerate(("linear1", "output")):
        for part in ("weight", "bias"):
            _put(state[f"base.net.layers.{i}.{part}"], base, f"{name}.{part}", files[0])
    for i, name in enumerate(_HIDDEN):
        _put(state[f"velocity.layers.{i}.weight"], velocity, f"{name}.weight", files[1])
    return state


def _put(into: Tensor, state: dict[str, Tensor], key: str, file: Path) -> None:
    """Copy ``state[key]``; a narrower matrix into the first columns."""
    found: Any = state.get(key)
    if found is None:
        raise InputError(f"{file}: no tensor '{key}'{nearest(key, state)}")
    if key == "linear1.weight" and found.shape[0] == into.shape[0]:
        into = into[:, : found.shape[1]] if into.dim() == 2 else into
    if found.shape != into.shape:
        raise InputError(f"{file}: '{key}' is {tuple(found.shape)}; expected {tuple(into.shape)}")
    into.copy_(found)
