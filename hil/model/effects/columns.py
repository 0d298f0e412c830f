"""What columns of effects are made of: what was recorded of n collects, and how it multiplies parameters."""

import math

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray, Sensor
from hil.campaign.stand_ins import WIDEST_DEGC
from hil.model.forms import bias_names

REFERENCE_DEGC = 25.0
LEVEL = "setpoint_degC|temperature_degC"
"""What tells one temperature that was gone to from another."""
HOUR_S = 3600.0


def channel_labels(sensor: Sensor) -> tuple[str, ...]:
    """Name each channel by its axis, as in BA and BB (by itself where two channels share an axis)."""
    return tuple(name[1:].lstrip("_") for name in bias_names(sensor))


def per_channel(values: FloatArray, sensor: Sensor) -> FloatArray:
    """Columns of one parameter per channel from what it multiplies, (n,) or (n, k): k per row; shape (n, c, k·c).

    The channels of one parameter stand together, as in `parameters_for`. Unknown values (NaN) become zero.
    """
    multipliers = np.nan_to_num(values.reshape(len(values), -1))
    channels = len(sensor.channels)
    columns = np.einsum("nk,cd->nckd", multipliers, np.eye(channels))
    return np.asarray(columns.reshape(len(values), channels, -1))


def column(conditions: Conditions, names: str) -> FloatArray:
    """Return a condition column, (n,), by its name or the first of "a|b" that the data has; NaN where it lacks it."""
    present = [name for name in names.split("|") if name in conditions.columns]
    return conditions.columns[present[0]] if present else np.full(len(conditions), np.nan)


def median_of(conditions: Conditions, names: str) -> float:
    """Return the median of a condition column over the rows that have it; NaN where none has."""
    values = column(conditions, names)
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def middle_hr(conditions: Conditions) -> FloatArray:
    """Return the middle of each row, hours from the campaign's beginning, (n,)."""
    return np.asarray((conditions.start_s + 0.5 * conditions.duration_s) / HOUR_S)


def above_reference(conditions: Conditions) -> FloatArray:
    """Return temperature_degC less the 25 °C about which all temperature terms of the catalogue are expanded, (n,)."""
    return column(conditions, "temperature_degC") - REFERENCE_DEGC


def begun_min(conditions: Conditions, name: str) -> FloatArray:
    """Return when what a column counts the seconds since began, in whole minutes of the campaign, (n,)."""
    return np.asarray(np.round((conditions.start_s - column(conditions, name)) / 60.0))


def visit_of_rows(conditions: Conditions) -> IntArray:
    """Return to which visit to a temperature each row belongs, (n,): the minute of the campaign at which it was set.

    Where that is not recorded they are counted, by steps of what tells the temperature.
    """
    given = begun_min(conditions, "time_since_setpoint_s")
    if np.all(np.isfinite(given)):
        return np.asarray(given.astype(np.int64))
    level, in_time = column(conditions, LEVEL), np.argsort(conditions.start_s, kind="stable")
    number = np.zeros(len(level), dtype=np.int64)
    number[in_time[1:]] = np.cumsum(np.abs(np.diff(level[in_time])) > WIDEST_DEGC)
    return number


def flattened(columns: FloatArray) -> FloatArray:
    """Return columns of shape (n, c, p) as (n·c, p)."""
    return columns.reshape(math.prod(columns.shape[:2]), columns.shape[2])
