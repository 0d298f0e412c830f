"""Which self-calibrations repeat each other: the runs that were made at one temperature."""

from __future__ import annotations

import numpy as np

from hil.campaign import Conditions, FloatArray

_SAME_TEMPERATURE_DEGC = 1.0


def runs_by_temperature(conditions: Conditions) -> list[tuple[float | None, tuple[int, ...]]]:
    """Group the runs that were made at one temperature: by setpoint, else by the unit's own thermometer.

    Groups come in the order of the temperature; without any temperature all runs are one group. A run whose own is not
    known is a group by itself (None): nobody can say that it repeats another.
    """
    runs = np.unique(conditions.run)
    known = next((n for n in ("setpoint_degC", "chamber_degC", "temperature_degC") if n in conditions.columns), None)
    if known is None:
        return [(None, tuple(int(run) for run in runs))]
    column = conditions.columns[known]
    means = {int(run): _mean(column[conditions.run == run]) for run in runs}
    groups: list[list[int]] = []
    for run in sorted(means, key=lambda each: (np.isnan(means[each]), means[each])):
        if groups and abs(means[run] - means[groups[-1][-1]]) <= _SAME_TEMPERATURE_DEGC:
            groups[-1].append(run)
        else:
            groups.append([run])
    told = [(float(np.mean([means[run] for run in group])), tuple(sorted(group))) for group in groups]
    return [(None if np.isnan(temperature) else temperature, group) for temperature, group in told]


def _mean(temperatures: FloatArray) -> float:
    """Return the mean of what is known, NaN where nothing is."""
    known = temperatures[np.isfinite(temperatures)]
    return float(known.mean()) if len(known) else float("nan")
