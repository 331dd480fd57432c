"""Building blocks of fitted methods: each once in torch, to fit, and once over columns, to run."""

from harness.nets.conditional import ConditionalMLP
from harness.nets.encoding import ConditionEncoder, sinusoids, sinusoids_columns
from harness.nets.mlp import MLP

__all__ = ["MLP", "ConditionalMLP", "ConditionEncoder", "sinusoids", "sinusoids_columns"]
