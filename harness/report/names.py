"""Names that a suite may use under ``report``; importing this imports nothing else."""

from __future__ import annotations

TABLES = ("table2", "equal-spp", "pdf", "bias", "timing", "status")
FIGURES = ("tradeoff", "convergence", "slices", "images")
