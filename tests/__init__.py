"""Tests of the harness and of its adapters."""

import os

if "PYTEST_XDIST_WORKER" in os.environ:
    # One thread a worker: several workers share the cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import harness  # noqa: E402, F401  before torch is imported: it sets what OpenMP reads then
