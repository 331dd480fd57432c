"""Figures that papers published, as data with their source: shown beside ours, never mixed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml


@dataclass(frozen=True)
class Published:
    """A paper's figures. ``table1`` and ``table2`` are as in the file, methods by our names."""

    source: dict[str, Any]
    methods: dict[str, str]
    table1: dict[str, Any]
    table2: dict[str, Any]

    @property
    def short(self) -> str:
        """Name and year."""
        return f"{self.source['name']} ({self.source['year']})"

    @property
    def citation(self) -> str:
        """One line: who, when, what, where."""
        about = self.source
        return (
            f"{about['authors']} ({about['year']}), {about['title']}, {about['venue']}, "
            f"doi:{about['doi']}"
        )

    def speed_ups(self, method: str) -> dict[str, float]:
        """Table 2's column of a method by material; {} where the paper has none."""
        columns = self.table2["columns"]
        if method not in columns:
            return {}
        at = columns.index(method)
        return {material: float(row[at]) for material, row in self.table2["rows"].items()}


@cache
def neusample() -> Published:
    """Tables 1 and 2 of Xu et al. (2023)."""
    text = (Path(__file__).parent / "neusample.yaml").read_text(encoding="utf-8")
    return Published(**yaml.safe_load(text))
