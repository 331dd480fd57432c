"""Images as OpenEXR."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from harness.mitsuba_runtime import exr

_ON_ONE_CORE = """
import os, sys
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from pathlib import Path
import numpy as np
from harness.mitsuba_runtime import exr
image = np.linspace(0, 1, 64 * 64 * 3).reshape(64, 64, 3)
Path(sys.argv[1]).write_bytes(exr.encoded(image))
print(float(np.abs(exr.read(Path(sys.argv[1])) - image).max()))
"""


def test_an_image_comes_back_in_half_precision(tmp_path):
    image = np.random.default_rng(1).random((20, 30, 3), np.float32)
    (tmp_path / "a.exr").write_bytes(exr.encoded(image))
    assert np.abs(exr.read(tmp_path / "a.exr") - image).max() <= 2**-11


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_a_process_of_one_core_writes_and_reads_too(tmp_path):
    """It would wait for a thread of a pool that has none."""
    command = [sys.executable, "-c", _ON_ONE_CORE, str(tmp_path / "a.exr")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert float(done.stdout) <= 2**-11
