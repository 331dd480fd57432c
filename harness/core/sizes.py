"""What no machine can do: bounds on the sizes that a suite may ask for, generous by orders."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

COUNT = 10**9
"""Rows, samples, steps: a thousand million rows of four numbers are 16 GB."""
SIDE = 2**15
"""Cells or pixels a side: a picture of that has 13 GB in three colours."""
SECONDS = 10.0**8
"""Three years."""
SEEDS = 2**31
"""A seed lies below; several streams are made of each, which are numbers of 64 bits."""
TRIALS = 200_000
"""Of one plan: at a second each they take more than two days."""
NAME = 100
"""Characters of a name: files are called by it, and their names may have 255 bytes."""

Count = Annotated[int, Field(gt=0, le=COUNT)]
Side = Annotated[int, Field(gt=0, le=SIDE)]
Seconds = Annotated[float, Field(gt=0, le=SECONDS)]
Seed = Annotated[int, Field(ge=0, lt=SEEDS)]
Name = Annotated[str, Field(max_length=NAME)]
