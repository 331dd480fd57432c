"""Tests of the harness and of its adapters."""

import harness  # noqa: F401  before torch is imported: it sets what OpenMP reads then
