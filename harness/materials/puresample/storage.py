"""Materials learned from walks as safetensors: weights, with sizes and training record inside."""

from __future__ import annotations

from harness.materials.network_files import NetworkFiles
from harness.materials.puresample.architecture import Architecture
from harness.materials.puresample.network import PureSample

_FILES = NetworkFiles(
    "puresample-material 1",
    Architecture,
    PureSample,
    textures=("texture",),
    command="harness material train --kind puresample",
    described="sizes",
)
save, load = _FILES.save, _FILES.load
metadata, record, reflectance_hash = _FILES.metadata, _FILES.record, _FILES.reflectance_hash
