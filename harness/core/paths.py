"""Where the project's own files are."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds ``harness`` and, in a clone, ``methods`` and ``suites``."""
METHODS = (ROOT / "harness" / "_methods").resolve()
"""The shipped methods: in a clone a link to ``methods``, in a wheel the files themselves."""
SUITES = (ROOT / "harness" / "_suites").resolve()
"""The shipped suites, likewise."""
