"""Neural materials as safetensors: weights, with description and training record inside."""

from __future__ import annotations

from harness.materials.network_files import NetworkFiles
from harness.materials.neural.architecture import Architecture
from harness.materials.neural.network import NeuralMBTF

FORMAT = "neural-material 1"
_FILES = NetworkFiles(
    FORMAT,
    Architecture,
    NeuralMBTF,
    textures=("texture", "offset.texture"),
    command="harness material train",
)
save, load, filled = _FILES.save, _FILES.load, _FILES.filled
metadata, record, reflectance_hash = _FILES.metadata, _FILES.record, _FILES.reflectance_hash
