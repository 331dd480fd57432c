"""Images in OpenEXR, where there is one processor."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

_ROUND_TRIP = """
import os, sys
from pathlib import Path
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import numpy as np
from harness.mitsuba_runtime import exr
image = np.arange(48, dtype=np.float32).reshape(4, 4, 3)
path = Path(sys.argv[1])
path.write_bytes(exr.encoded(image))
assert np.array_equal(exr.read(path), image)
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity of processes here")
def test_one_processor_is_enough(tmp_path):
    """Mitsuba's reader and writer wait for a worker, of which Dr.Jit's pool has none then."""
    command = [sys.executable, "-c", _ROUND_TRIP, str(tmp_path / "image.exr")]
    subprocess.run(command, check=True, timeout=120)
