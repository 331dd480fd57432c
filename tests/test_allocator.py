"""Memory that stays: a call that was made before takes no page from the system."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COUNT = """
import resource, torch
x = torch.rand(65536, 32)
def call():
    return sum(part.sum() for part in [x + i for i in range(4)])
for _ in range(10):
    call()
taken = []
for _ in range(11):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    call()
    taken.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
print(sorted(taken)[5])
"""


def faults(first: str) -> int:
    """Page faults of a call that frees four buffers of 8 MiB: the median, for a heap may grow.

    The C library is told to map each of them anew, as it does by itself in most processes.
    """
    done = subprocess.run(
        [sys.executable, "-c", first + COUNT],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "MALLOC_MMAP_THRESHOLD_": "131072"},
    )
    return int(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="counts page faults, as Linux does")
def test_freed_memory_is_kept() -> None:
    from harness.core import allocator

    if not allocator.keep():
        pytest.skip("a C library without mallopt")
    kept, mapped = faults("import harness\n"), faults("")
    assert kept < 16 <= mapped  # a buffer: 2048 pages, or 4 where they are huge


def test_what_is_free_can_be_given_back() -> None:
    """The resident memory of a process shrinks by what it freed."""
    code = """
import harness, torch
from harness.core import allocator
def resident():
    return int(open('/proc/self/statm').read().split()[1]) * 4096
kept = torch.ones(64 << 20, dtype=torch.uint8)
parts = [torch.ones(8 << 20, dtype=torch.uint8) for _ in range(32)]
del parts
before = resident()
allocator.give_back()
print(before - resident())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 200 << 20
