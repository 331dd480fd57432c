"""What a suite may say. Unknown keys and wrong types are refused, nothing is converted.

An entry of ``materials``, ``methods``, ``scenes`` and ``measures`` is a name, or a mapping
with the key ``name``; here it is always a mapping (see :mod:`harness.suite.load`).
"""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from harness.core.schema import Strict, Word
from harness.core.sizes import COUNT, Count, Name, Seconds, Seed, Side

T = TypeVar("T")
Some = Annotated[list[T], Field(min_length=1)]


class BudgetSpec(Strict):
    """Part of a fitting budget; what is left out keeps its default. See harness.Budget."""

    steps: Annotated[int, Field(ge=0, le=COUNT)] | None = None
    conditions: Count | None = None
    directions: Count | None = None
    resolution: Side | None = None
    pool: Count | None = None
    max_seconds: Seconds | None = None
    seconds: Seconds | None = None
    until: Annotated[float, Field(gt=0, lt=1)] | None = None

    def given(self) -> dict[str, Any]:
        """The entries that are set."""
        return self.model_dump(exclude_none=True)


class Override(Strict):
    """What a profile changes about one method."""

    params: dict[str, Any] = {}
    budget: BudgetSpec = BudgetSpec()


class MethodSpec(Override):
    """A method of the suite; ``label`` is what tables call it and must be unique.

    ``measures`` are those that are taken of it, by default all of the suite's. ``sweep`` makes
    several of it (:mod:`harness.suite.sweep`): values by knob, or ``knobs`` for all that the
    adapter declares. ``first_fit_only`` measures it with the first training seed alone: it has
    nothing to fit, so that another seed says nothing more.
    """

    name: str
    label: Name = ""
    measures: Some[str] | None = None
    first_fit_only: bool = False
    sweep: Any = None  # checked there, where the message can name the knobs

    _swept_from: str = PrivateAttr("")
    _knob: str = PrivateAttr("")

    @property
    def swept_from(self) -> str:
        """Label of the method that this one is a variant of; "" if it was written out."""
        return self._swept_from

    @property
    def knob(self) -> str:
        """The one thing in which it differs from that method, as a sweep calls it."""
        return self._knob

    def set_apart(self, base: str, knob: str) -> None:
        """Mark as the variant of the method labelled ``base`` in ``knob``."""
        self._swept_from, self._knob = base, knob


class NamedSpec(BaseModel):
    """A material, scene or measure: a name, and whatever else its own registry checks."""

    model_config = ConfigDict(extra="allow", strict=True)

    name: Name

    def rest(self) -> dict[str, Any]:
        """All entries but the name."""
        return dict(self.model_extra or {})


class MeasureSpec(NamedSpec):
    """A measure; with ``first_fit_only`` of the fits of the first training seed alone.

    ``materials`` and ``scenes`` are those that it is taken of, by default all of the suite's.
    """

    first_fit_only: bool = False
    materials: Some[str] | None = None
    scenes: Some[str] | None = None

    def of(self, material: str, scene: str | None = None) -> bool:
        """Whether it is taken of the material, and in the scene."""
        return (self.materials is None or material in self.materials) and (
            self.scenes is None or scene is None or scene in self.scenes
        )


class ReportSpec(Strict):
    """Tables and figures wanted; ``None`` means the report's own choice."""

    tables: list[str] | None = None
    figures: list[str] | None = None


class Profile(Strict):
    """One size of the suite: a subset of it, budgets and settings."""

    materials: Some[str] | None = None
    methods: Some[str] | None = None
    scenes: Some[str] | None = None
    seeds: Some[Seed] | None = None
    training_seeds: Some[Seed] | None = None
    resolution: Side | None = None
    budget: BudgetSpec = BudgetSpec()
    measures: dict[str, dict[str, Any]] = {}
    override: dict[str, Override] = {}


class Suite(Strict):
    """A whole suite: materials x methods x scenes x measures, tables and figures.

    ``training_seeds`` are of the fits, ``seeds`` of what is measured with each of them
    (:mod:`harness.suite.seeds`). ``tuned`` is a file with parameters of the methods
    (:mod:`harness.suite.tuned`).
    """

    name: Word
    title: str = ""
    materials: Some[NamedSpec]
    methods: Some[MethodSpec]
    scenes: list[NamedSpec] = []
    measures: Some[MeasureSpec]
    seeds: Some[Seed] = [0]
    training_seeds: Some[Seed] | None = None
    baseline: str | None = None
    resolution: Side | None = None
    tuned: str | None = None
    parameters: dict[str, bool | int | float | str] = {}
    budget: BudgetSpec = BudgetSpec()
    report: ReportSpec = ReportSpec()
    profiles: dict[str, Profile] = {}

    @model_validator(mode="before")
    @classmethod
    def _empty_is_absent(cls, data: Any) -> Any:
        # A key with nothing after it is null in YAML; it means the same as no key.
        if isinstance(data, dict):
            return {key: value for key, value in data.items() if value is not None}
        return data
