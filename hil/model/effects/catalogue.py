"""The catalogue: every effect by its id. Adding one is a class in its family's file.

effect_by_id("MU_real")
askable(conditions, base)          # what this data can be asked about, and why not the rest
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationInfo

from drivers.outside import brought, loaded
from hil.campaign import Conditions
from hil.errors import InputError
from hil.model.effects import (
    data,
    dynamics,
    electronics,
    environment,
    g_linear,
    g_squared,
    noise,
    pickoff,
    series,
    setup,
    thermal,
    vibration,
)
from hil.model.effects.base import Base, Described, Effect, VarianceEffect
from hil.model.effects.empirical import PREFIX, EmpiricalTerm
from hil.model.effects.inside import SeriesEffect
from procedures.words import listed

BASE_EFFECTS: tuple[Effect, ...] = (g_linear.Bias(),)
"""In every model, so never looked for."""

_BROUGHT = tuple(made() if isinstance(made, type) else made for made in map(loaded, brought("hil.effects").values()))
"""Effects of other installed distributions: classes, or instances, of any of the three kinds below."""

_FAMILIES = (
    thermal, g_linear, g_squared, pickoff, setup, data, noise, dynamics, vibration, electronics, environment, series,
)  # fmt: skip
_EVERY: tuple[Described, ...] = (
    *(
        each()
        for family in _FAMILIES
        for each in vars(family).values()
        if isinstance(each, type) and issubclass(each, Described)
        if each.__module__ == family.__name__ and hasattr(each, "id")
    ),
    *_BROUGHT,
)
"""One of each class, as they stand in the files of the families, then what others bring."""

EFFECTS = tuple(each for each in _EVERY if isinstance(each, Effect) and each.id not in {of.id for of in BASE_EFFECTS})
"""Effects on the averages of collects."""

VARIANCE_EFFECTS = tuple(each for each in _EVERY if isinstance(each, VarianceEffect))
"""Effects that only scatter the averages."""

SERIES_EFFECTS = tuple(each for each in _EVERY if isinstance(each, SeriesEffect))
"""Effects that show in the series of samples within a collect. Some have the id of an effect on averages: one cause."""


FORM_EFFECTS: Mapping[str, tuple[str, ...]] = {
    "constant": ("bias",),
    "collins-4": ("bias", "GS"),
    "matrix-6": ("bias", "GS", "MU_real"),
    "matrix-6-thermal": ("bias", "GS", "MU_real", "bias_T", "GS_T", "MU_T"),
    "triad-12": ("bias", "g_sensitivity"),
}
"""The built-in models as sums of effects: what each of them has already."""


def entries() -> tuple[Described, ...]:
    """Return every entry of the catalogue, effects on averages first."""
    return (*BASE_EFFECTS, *EFFECTS, *VARIANCE_EFFECTS, *SERIES_EFFECTS)


def effect_by_id(identifier: str) -> Effect:
    """Return the effect on averages with this id (or the empirical term); raise `InputError` where there is none."""
    for effect in (*BASE_EFFECTS, *EFFECTS):
        if effect.id == identifier:
            return effect
    if identifier.startswith(PREFIX):
        parameter, _, driver = identifier.removeprefix(PREFIX).partition("*")
        if not (parameter and driver):
            raise InputError(f"effect {identifier}: an empirical term is written empirical:PARAMETER*CONDITION_COLUMN")
        return EmpiricalTerm(parameter, driver)
    if identifier in {entry.id for entry in VARIANCE_EFFECTS}:
        raise InputError(f"effect {identifier} scatters averages: write it in noise, in the sensor's scatter")
    if identifier in {entry.id for entry in SERIES_EFFECTS}:
        raise InputError(f"effect {identifier} shows within collects and moves no average: take it out of the terms")
    raise InputError(f"no effect of the catalogue has the id {identifier}; `hil effects` lists them")


def variance_effect_by_id(identifier: str) -> VarianceEffect:
    """Return the effect on the scatter with this id; raise `InputError` naming all where there is none."""
    for effect in VARIANCE_EFFECTS:
        if effect.id == identifier:
            return effect
    known = ", ".join(effect.id for effect in VARIANCE_EFFECTS)
    raise InputError(f"no effect that scatters averages has the id {identifier}; there are {known}")


def known_by(find: Callable[[str], object]) -> Callable[[str, ValidationInfo], str]:
    """Return a check of an id in a file, by one of the above: told at its key, before what is missing beside it.

    Files are read with a context; what a search has found needs none, and may be an effect of its caller's own.
    """

    def check(identifier: str, info: ValidationInfo) -> str:
        try:
            if info.context:
                find(identifier)
        except InputError as error:
            raise ValueError(str(error)) from error
        return identifier

    return check


def named(effect: Effect) -> Effect:
    """Return the effect under whose name this one is found: itself, as a rule."""
    return effect_by_id(effect.known_as) if effect.known_as else effect


def over_temperature(effect: Effect) -> Effect:
    """Return the entry that describes how values of an effect follow temperature, MU_T of MU_real; else its name's."""
    of = (each for each in (effect, *EFFECTS) if effect.id in (each.id, each.known_as))
    return next((each for each in of if each.follows == "temperature"), named(effect))


NO_VALUES = "cannot be asked: needs values of the base model"
NO_EARTH_RATE = "cannot be asked: needs the earth rate, which is 0 in every row"


def why_not(effect: Effect, conditions: Conditions, base: Base | None) -> str:
    """Say why this data cannot be asked about an effect; empty where it can."""
    if not effect.applies_to(conditions.sensor):
        return f"does not exist in a sensor with channels {', '.join(conditions.sensor.channels)}"
    lacking = effect.missing(conditions)
    if lacking:
        return f"cannot be asked: needs {', '.join(need.replace('|', ' or ') for need in lacking)}"
    if effect.needs_base and base is None:
        return NO_VALUES
    if effect.needs_slopes and (base is None or base.bias_slope is None or base.k_slope is None):
        return "cannot be asked: needs a base model that depends on temperature"
    if not effect.shape_grid(conditions):
        return f"cannot be asked: needs {effect.asks_for}"
    if effect.needs_base and base is not None and not np.all(np.isfinite(base.rates)):
        return "cannot be asked: the base model has no value in some rows"
    return ""


@dataclass(frozen=True)
class Unasked:
    """An effect that cannot be tried, how probable it is beside the name whose rows it shares, and what tells it."""

    effect: Effect | VarianceEffect
    weight: float
    remedy: str


def of_its_history(effect: Effect, conditions: Conditions, shape: Mapping[str, float]) -> Iterator[Unasked]:
    """Yield what has an effect's history in time and cannot be tried in these rows, or is the same in them.

    What cannot be in this sensor is no rival.
    """

    def there(names: Mapping[str, float]) -> Iterator[tuple[Effect, float]]:
        every = ((effect_by_id(name), weight) for name, weight in names.items())
        return ((other, weight) for other, weight in every if other.applies_to(conditions.sensor))

    for other, weight in there(effect.kin_for(conditions, shape)):
        if needs := other.missing(conditions):
            yield Unasked(other, weight, f"record {listed(need.replace('|', ' or ') for need in needs)}")
        elif not other.shape_grid(conditions):
            yield Unasked(other, weight, other.experiment)
    for other, weight in there(effect.aliases_for(conditions)):
        yield Unasked(other, weight, effect.experiment)


def askable(conditions: Conditions, base: Base | None) -> tuple[tuple[Effect, ...], dict[str, str]]:
    """Return the effects on averages that this data can be asked about, and for each other id why not."""
    reasons = {effect.id: why_not(effect, conditions, base) for effect in EFFECTS}
    return (
        tuple(effect for effect in EFFECTS if not reasons[effect.id]),
        {identifier: reason for identifier, reason in reasons.items() if reason},
    )
