"""A network of the condition alone."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from harness.core.columns.bridge import Columns
from harness.core.protocol.material import Material
from harness.nets.encoding import ConditionEncoder
from harness.nets.mlp import MLP


class ConditionalMLP(nn.Module):
    """Encoded condition -> hidden layers -> outputs: [B, C] -> [B, outputs]."""

    def __init__(
        self,
        material: Material,
        hidden: Sequence[int],
        outputs: int,
        activation: str = "relu",
        frequencies: int = 5,
    ):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features, frequencies)
        self.mlp = MLP([self.encoder.width, *hidden, outputs], activation)

    def forward(self, condition: Tensor) -> Tensor:
        """[..., C] -> [..., outputs]."""
        return self.mlp(self.encoder(condition))

    def columns(self, c: Columns) -> Columns:
        """The same over columns."""
        return self.mlp.columns(self.encoder.encoded(c))
