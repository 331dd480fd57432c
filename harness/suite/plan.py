"""Expands a suite into its trials. All names are resolved here, before anything runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from harness.core import machine, registry
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.method import Budget
from harness.core.sizes import TRIALS
from harness.identity.named_files import replaced
from harness.measures import registry as measures
from harness.mitsuba_runtime.xml_file import checked
from harness.suite import fast, seeds
from harness.suite.load import Loaded
from harness.suite.resolve import Resolved
from harness.suite.schema import MethodSpec, NamedSpec, Profile, Suite
from harness.suite.sweep import BUDGET
from harness.suite.trials import FIT, Trial, counted_budget, hash_of

Item = TypeVar("Item", NamedSpec, MethodSpec)

DEFAULT_PROFILE = "quick"
DEFAULT_BASELINE = "improved-baseline"


@dataclass(frozen=True)
class Plan:
    """All trials of a suite in one profile, in the order in which they run and are shown."""

    suite: str
    title: str
    profile: str
    device: str
    baseline: str
    report: dict[str, Any]
    trials: list[Trial]
    text: str
    where: str
    """The suite as the user named it."""
    note: str = ""
    """What is to be said of all its numbers."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Commands that make materials of the suite whose file is not there, by name."""
    resolved: Resolved = field(default_factory=Resolved, compare=False, repr=False)

    def baseline_of(self, trial: Trial) -> Trial:
        """The trial of the baseline that a timed trial is compared with."""
        return self._baselines[_place(trial)]

    @cached_property
    def _baselines(self) -> dict[tuple, Trial]:
        return {_place(t): t for t in self.trials if t.method == self.baseline}

    def labels(self, key: str) -> list[str]:
        """Labels of all ``material``, ``method``, ``scene`` or ``measure``, in order."""
        return list(dict.fromkeys(x for t in self.trials if (x := getattr(t, key)) != ""))


def make_plan(
    loaded: Loaded,
    profile: str | None = None,
    device: str = "cpu",
    fitted: Callable[[Trial], Any] = lambda trial: None,
    on: dict[str, Any] | None = None,
) -> Plan:
    """The plan of ``loaded`` in ``profile`` (by default ``quick``, if the suite has it).

    ``fitted`` says whether a fit need not be run, for the profile ``fast``, which makes others
    small. ``on`` is the identity of the machine that times are of, by default of this one.
    """
    suite = loaded.suite
    try:
        name, chosen = _profile(suite, profile)
        if profile == fast.NAME and name not in suite.profiles:
            usual = make_plan(loaded, None, device).trials
            there = {t.method for t in usual if t.material == usual[0].material and fitted(t)}
            chosen = fast.profile_of(suite, suite.profiles.get(DEFAULT_PROFILE, Profile()), there)
        said = fast.note(chosen) if name == fast.NAME and name not in suite.profiles else ""
        baseline = _baseline(suite, chosen)
        expansion = _Expansion(suite, name, chosen, device, baseline, loaded.path.parent, on)
        return Plan(
            suite=suite.name,
            title=f"{suite.title or suite.name}{f' ({said})' if said else ''}",
            profile=name,
            device=device,
            baseline=baseline,
            report=suite.report.model_dump(),
            trials=expansion.trials(),
            text=loaded.text,
            where=str(loaded.path),
            note=said,
            left_out=loaded.left_out,
            resolved=expansion.resolved,
        )
    except InputError as error:
        raise InputError(f"{loaded.path}: {error}") from None


def _place(trial: Trial) -> tuple:
    return trial.measure, trial.material, trial.scene, trial.seed


def _profile(suite: Suite, name: str | None) -> tuple[str, Profile]:
    if name is None:
        name = DEFAULT_PROFILE if DEFAULT_PROFILE in suite.profiles else ""
        return name, suite.profiles.get(name, Profile())
    if name == fast.NAME and name not in suite.profiles:
        return name, Profile()  # made by :mod:`harness.suite.fast`
    if name not in suite.profiles:
        hint = nearest(name, [*suite.profiles, fast.NAME])
        raise InputError(f"profiles: unknown profile '{name}'{hint}")
    return name, suite.profiles[name]


def _baseline(suite: Suite, profile: Profile) -> str:
    """The method that all others are compared with: as written, or the usual, or the first."""
    chosen = _chosen(suite.methods, profile.methods)
    # What others are compared with is needed wherever they are measured.
    whole = [m.label for m in chosen if m.measures is None and not m.first_fit_only]
    if suite.baseline is None:
        if not whole:
            raise InputError(
                "methods: all of them have measures of their own; expected one without,"
                " which the others are compared with"
            )
        return DEFAULT_BASELINE if DEFAULT_BASELINE in whole else whole[0]
    if suite.baseline not in [m.label for m in chosen]:
        raise InputError(f"baseline: '{suite.baseline}' is left out by the profile's methods")
    if suite.baseline not in whole:
        raise InputError(
            f"baseline: '{suite.baseline}' has measures of its own; expected a method without,"
            " which all measures are taken of"
        )
    return suite.baseline


class _Expansion:
    """The product itself. Every entry of the suite is resolved, chosen by the profile or not."""

    def __init__(
        self,
        suite: Suite,
        profile_name: str,
        profile: Profile,
        device: str,
        baseline: str,
        folder: Path,
        on: dict[str, Any] | None = None,
    ):
        from harness.materials import registry as materials
        from harness.scenes import registry as scenes

        self.suite, self.profile, self.profile_name = suite, profile, profile_name
        self.device, self.on = device, on
        self.settings = self._settings()
        self.measures = {m.name: m for m in suite.measures}
        self.kinds = {name: measures.load(name) for name in self.settings}
        _each("methods", suite.methods, lambda m: registry.find(m.name))
        self.materials = _each(
            "materials", suite.materials, lambda m: materials.identity(checked(_spec(m)))
        )
        self.resolved = Resolved()
        self.scenes = _each(
            "scenes",
            suite.scenes,
            lambda s: scenes.identity_of(_spec(s), self.resolved.scene_of(checked(_spec(s)))),
        )
        for name, kind in self.kinds.items():
            said = [self._why_not(name, scene) for scene in suite.scenes if kind.needs_scene]
            if said and all(said):
                raise InputError(f"measures: '{name}': {'; '.join(said)}")
        self.methods = [self._overridden(m) for m in _chosen(suite.methods, profile.methods)]
        self.described = {
            method.label: {
                "name": registry.find(method.name).name,
                "params": replaced(method.params, folder),
                "budget": counted_budget(self._budget(method)),
            }
            for method in self.methods
        }
        self.baseline = self.described[baseline]

    def trials(self) -> list[Trial]:
        """Materials, then seeds, then methods; of each the fit, then its measures."""
        found: dict[str, Trial] = {}
        pairs = seeds.pairs(
            self.profile.seeds or self.suite.seeds,
            self.profile.training_seeds or self.suite.training_seeds,
        )
        chosen = _chosen(self.suite.materials, self.profile.materials)
        if not chosen:
            raise InputError(f"profiles.{self.profile_name}.materials: none of them is made yet")
        scenes = _chosen(self.suite.scenes, self.profile.scenes)
        each = sum(len(scenes) if kind.needs_scene else 1 for kind in self.kinds.values())
        count = len(chosen) * len(pairs) * len(self.methods) * each
        if count > TRIALS:
            raise InputError(f"asks for {count:,} trials; expected at most {TRIALS:,}")
        for material in chosen:
            for training, seed in pairs:
                first = training == pairs[0][0]
                for method in self.methods:
                    if method.first_fit_only and not first:
                        continue
                    # Of several seeds measured with one fit, that is planned once.
                    for trial in self._of_method(material, training, seed, method, first):
                        found.setdefault(f"{trial.hash} {trial.method}", trial)
        return list(found.values())

    def _of_method(
        self, material: NamedSpec, training: int, seed: int, method: MethodSpec, first: bool
    ) -> list[Trial]:
        """The fit of one method to one material, and all that is measured with it.

        ``first``: whether it is of the first training seed, the only one for some measures.
        """
        blank = Trial(
            hash="",
            identity={
                "material": self.materials[material.name],
                "method": self.described[method.label],
                "seed": training,
            },
            suite=self.suite.name,
            material=material.name,
            method=method.label,
            scene="",
            measure="",
            seed=training,
            method_name=method.name,
            params=method.params,
            budget=self._budget(method),
            material_spec=_spec(material),
        )
        fit = self._trial(blank, FIT)
        found = [fit]
        for name in self.settings:
            if name == FIT or (method.measures is not None and name not in method.measures):
                continue
            spec = self.measures[name]
            if (spec.first_fit_only and not first) or not spec.of(material.name):
                continue
            identity = blank.identity | {"seed": seed}
            if seed != training:
                identity["training_seed"] = training
            one = replace(blank, fit=fit.hash, seed=seed, identity=identity)
            if not self.kinds[name].needs_scene:
                found.append(self._trial(one, name))
                continue
            for scene in _chosen(self.suite.scenes, self.profile.scenes):
                if not spec.of(material.name, scene.name) or self._why_not(name, scene):
                    continue
                here = {**one.identity, "scene": self.scenes[scene.name]}
                placed = replace(one, scene=scene.name, scene_spec=_spec(scene), identity=here)
                found.append(self._trial(placed, name))
        return found

    def _why_not(self, measure: str, scene: NamedSpec) -> str:
        return self.kinds[measure].why_not(self.resolved.scene_of(_spec(scene)))

    def _trial(self, blank: Trial, name: str) -> Trial:
        """``blank`` with the measure ``name`` filled in, and its hash."""
        measure, settings = self.kinds[name], self.settings[name]
        identity = {
            **blank.identity,
            "measure": {"name": name, "settings": settings},
        }
        if measure.timed:
            # Numbers in comparison with the baseline change with the baseline.
            identity["baseline"] = self.baseline
        if measure.on_machine():
            identity["machine"] = self.on or machine.identity(self.device)
        return replace(
            blank,
            identity=identity,
            hash=hash_of(identity),
            measure=name,
            settings=settings,
            timed=measure.timed,
        )

    def _settings(self) -> dict[str, dict[str, Any]]:
        """Settings of every measure by name, the fit first; all profiles are checked."""
        for name, profile in self.suite.profiles.items():
            self._settings_in(name, profile)
        return self._settings_in(self.profile_name, self.profile)

    def _settings_in(self, profile_name: str, profile: Profile) -> dict[str, dict[str, Any]]:
        """Defaults < suite's resolution < suite < profile's resolution < profile."""
        found = {FIT: measures.settings(FIT, {})}
        for index, item in enumerate(self.suite.measures):
            where = f"measures[{index}]"
            try:
                measure = measures.load(item.name)
                # The size of a render; a measure without a scene has its own idea of it.
                sized = measure.needs_scene and "resolution" in measure.Settings.model_fields
                sizes = [
                    {"resolution": owner.resolution} if sized and owner.resolution else {}
                    for owner in (self.suite, profile)
                ]
                given = sizes[0] | item.rest() | sizes[1]
                found[item.name] = measures.settings(item.name, given)
                if measure.needs_scene and not self.suite.scenes:
                    raise InputError(f"'{item.name}' needs scenes; there are none")
                where = f"profiles.{profile_name}.measures.{item.name}"
                given |= profile.measures.get(item.name, {})
                found[item.name] = measures.settings(item.name, given)
            except InputError as error:
                raise InputError(f"{where}: {error}") from None
        return found

    def _overridden(self, method: MethodSpec) -> MethodSpec:
        """With the profile's parameters; those of a swept method reach its variants.

        The knob that a variant stands for stays as it is, unless its own label is overridden.
        """
        params = {**method.params}
        for label in (method.swept_from, method.label):
            if label in self.profile.override:
                kept = {method.knob} if label == method.swept_from else set()
                given = self.profile.override[label].params
                params |= {key: value for key, value in given.items() if key not in kept}
        return method.model_copy(update={"params": params})

    def _budget(self, method: MethodSpec) -> Budget:
        """Defaults < suite < profile < method < the profile's override of the method.

        As with parameters, the override of a swept method reaches its variants.
        """
        layers = [self.suite.budget, self.profile.budget, method.budget]
        given: dict[str, Any] = {}
        for layer in layers:
            given = _over(given, layer.given(), method.label)
        for label in (method.swept_from, method.label):
            if label in self.profile.override:
                kept = {method.knob} if label == method.swept_from else set()
                change = self.profile.override[label].budget.given()
                change = {k: v for k, v in change.items() if BUDGET + k not in kept}
                given = _over(given, change, method.label)
        return Budget(**given, device=self.device)


def _over(given: dict[str, Any], change: dict[str, Any], label: str) -> dict[str, Any]:
    """A budget and what a closer place says of it: one of ``seconds`` and ``until`` ends a fit."""
    ends = {"seconds", "until"}
    if ends <= set(change):
        raise InputError(f"the budget of '{label}' has both seconds and until; expected one")
    if ends & set(change):
        given = {key: value for key, value in given.items() if key not in ends}
    return given | change


def _spec(item: NamedSpec) -> Any:
    """As a registry takes it: the bare name, or the mapping with more than a name."""
    return {"name": item.name, **item.rest()} if item.rest() else item.name


def _chosen(items: list[Item], wanted: list[str] | None) -> list[Item]:
    if wanted is None:
        return items
    return [item for item in items if (getattr(item, "label", "") or item.name) in wanted]


def _each(key: str, items: list[Item], resolve: Callable[[Item], Any]) -> dict[str, Any]:
    """``resolve`` of every item by label; a refusal gets the key path in front."""
    found = {}
    for index, item in enumerate(items):
        try:
            found[getattr(item, "label", "") or item.name] = resolve(item)
        except InputError as error:
            raise InputError(f"{key}[{index}]: {error}") from None
    return found
