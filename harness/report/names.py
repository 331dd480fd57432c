"""Names that a suite may use under ``report``; importing this imports nothing else."""

from __future__ import annotations

TABLES = (
    "table1",
    "table2",
    "equal-spp",
    "pdf",
    "bias",
    "timing",
    "breakeven",
    "ranking",
    "stability",
    "image-checks",
    "sample-weights",
    "importance-maps",
    "levels",
    "effects",
    "effect-counts",
    "status",
)
FIGURES = (
    "materials",
    "tradeoff",
    "pareto",
    "breakeven",
    "convergence",
    "slices",
    "images",
    "heatmap",
    "importance-maps",
    "effects",
)
