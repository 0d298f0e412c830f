"""The catalogue: every effect by its id. Adding one is a class in its family's file and a line here.

effect_by_id("MU_real")
"""

from __future__ import annotations

from hil.effects.base import Effect, SeriesEffect, VarianceEffect
from hil.effects.thermal import TemperatureRateBias
from hil.errors import InputError

EFFECTS: tuple[Effect, ...] = (TemperatureRateBias(),)
"""Effects on the averages of collects."""

VARIANCE_EFFECTS: tuple[VarianceEffect, ...] = ()
"""Effects that only scatter the averages."""

SERIES_EFFECTS: tuple[SeriesEffect, ...] = ()
"""Effects that show in the series of samples within a collect."""


def effect_by_id(identifier: str) -> Effect:
    """Return the effect on averages with this id; raise `InputError` where there is none."""
    for effect in EFFECTS:
        if effect.id == identifier:
            return effect
    raise InputError(f"no effect of the catalogue has the id {identifier}; `hil effects` lists them")
