"""Whether the model's parameters are one set for the whole campaign, or one set at each temperature.

A built-in model has no values: they are fitted, so that what remains is the model's form and not its calibration. The
plain calibration is one set of values. Where a unit is calibrated at each temperature, as the report's Table 1 is, the
alternative is the same form with values of its own at every setpoint. It is no effect and gets no name; it must pay for
its many values: the two calibrations, each with what the search finds beside it, are compared by their evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray
from hil.model import Model
from hil.model.forms import LinearForm
from hil.reconcile.search.evidence import BlockEvidence
from hil.solve.identifiability import independent_columns
from hil.solve.likelihood import NoiseTable
from hil.solve.rows import Block
from hil.solve.temperatures import same_temperature

ONE_SET = "one set"
PER_TEMPERATURE = "per temperature"
_LEAST_STATIONS = 3
CALIBRATED = frozenset({"constant", "collins-4", "matrix-6", "triad-12"})


@dataclass(frozen=True)
class PerTemperatureForm(LinearForm):
    """A form with values of its own at each setpoint: parameter by parameter, coldest setpoint first."""

    centres_degC: tuple[float, ...] = ()
    plain_names: tuple[str, ...] = ()
    plain_units: tuple[str, ...] = ()


def per_temperature(form: LinearForm, conditions: Conditions) -> LinearForm:
    """Return the form with one value per parameter and setpoint; the form itself where setpoints are unknown or few."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.all(np.isfinite(temperature)):
        return form
    numbers = same_temperature(conditions)
    if numbers.max() + 1 < _LEAST_STATIONS:
        return form
    centres = tuple(float(np.mean(temperature[numbers == k])) for k in range(numbers.max() + 1))

    def build(rows: Conditions) -> FloatArray:
        plain = form.build(rows)
        nearest = np.argmin(np.abs(rows.columns["temperature_degC"][:, None] - np.array(centres)), axis=1)
        at = (nearest[:, None] == np.arange(len(centres))).astype(np.float64)
        return np.asarray((plain[..., None] * at[:, None, None, :]).reshape(*plain.shape[:2], -1))

    return PerTemperatureForm(
        name=form.name,
        names=tuple(f"{name} at {centre:.1f} degC" for name in form.names for centre in centres),
        units=tuple(unit for unit in form.units for _ in centres),
        build=build,
        centres_degC=centres,
        plain_names=form.names,
        plain_units=form.units,
    )


def may_differ(model: Model, campaign: Campaign) -> bool:
    """Whether another calibration can be asked about: a built-in without values, and a sensor with several setpoints.

    `matrix-6-thermal` says itself how its values follow temperature.
    """
    if model.form not in CALIBRATED or model.sensors or model.terms:
        return False
    return any(
        (temperature := collects.conditions.columns.get("temperature_degC")) is not None
        and np.all(np.isfinite(temperature))
        and same_temperature(collects.conditions).max() + 1 >= _LEAST_STATIONS
        for collects in campaign.sensors.values()
    )


def log_evidence(
    plain: Sequence[Block],
    levelled: Sequence[Block],
    tables: Sequence[NoiseTable],
    rich: Sequence[Sequence[FloatArray]],
) -> float | None:
    """Log Bayes factor of one set per temperature against one set, effects apart; None where rows do not correspond.

    `rich` are the rich models of the means of each block, each (N, p).
    """
    if len(plain) != len(levelled) or any(len(a.y) != len(b.y) for a, b in zip(plain, levelled, strict=True)):
        return None
    total = 0.0
    for one, several, table, extra in zip(plain, levelled, tables, rich, strict=True):
        both = independent_columns(np.hstack([one.base, several.base]), 1e-6)
        further = both[:, one.base.shape[1] :]
        if further.shape[1]:
            evidence = BlockEvidence(one, table, [further], extra)
            total += float(evidence.log_factors(one.y[:, None])[0, 0])
    return total
