"""What stands in for a condition that a campaign does not record: asked by every analysis, as reconcile asks it.

    with_stand_ins(campaign).sensors[2].conditions.columns["temperature_degC"]  # the chamber's, where the unit has none

What says how the unit was (its own range, whether it had settled) asks the campaign as it is.
"""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.campaign.data import Campaign, Collects, Conditions
from procedures.words import numbered

_STAND_INS = ("case_degC", "chamber_degC", "setpoint_degC")
"""What stands in for the unit's own temperature where that is not recorded, the best first."""

_SPELLINGS = {
    "supply_V": re.compile(r"supply|volt", re.IGNORECASE),
    "vibration_rms_g": re.compile(r"vibration|vib_", re.IGNORECASE),
    "spin_period_us": re.compile(r"(spin|rotor).*(period|_us)", re.IGNORECASE),
}
"""Conditions that effects ask for, and how else people call them."""


def with_stand_ins(campaign: Campaign) -> Campaign:
    """Give every sensor the conditions that effects ask for under the names that they ask by.

    The case's, the chamber's or the setpoint's temperature stands in for the unit's where that is not recorded; other
    spellings of a condition are recognised. Said in the campaign's warnings.
    """
    sensors, said = dict(campaign.sensors), []
    for number, collects in campaign.sensors.items():
        conditions = collects.conditions
        found = dict(_stand_ins(conditions))
        if not found:
            continue
        columns = {**conditions.columns, **{name: conditions.columns[other] for name, other in found.items()}}
        renamed = replace(conditions, columns=columns)
        sensors[number] = Collects(renamed, collects.rates_deg_per_hr, collects.rates_se_deg_per_hr)
        said += [not_recorded(conditions, name, other) for name, other in found.items()]
    warnings = list(dict.fromkeys([*campaign.warnings, *said]))
    return replace(campaign, sensors=sensors, warnings=warnings) if said else campaign


def _stand_ins(conditions: Conditions) -> Iterator[tuple[str, str]]:
    """Yield what is not recorded, with the column that stands in for it."""
    columns = conditions.columns
    if other := instead_of_temperature(conditions):
        yield "temperature_degC", other
    for name, spelling in _SPELLINGS.items():
        others = [one for one in columns if spelling.search(one) and np.isfinite(columns[one]).all()]
        if name not in columns and len(others) == 1:
            yield name, others[0]


def instead_of_temperature(conditions: Conditions) -> str | None:
    """Return the column that stands in for the unit's own temperature; None where that, or nothing, is recorded."""
    whole = {name for name, values in conditions.columns.items() if np.all(np.isfinite(values))}
    return next((name for name in _STAND_INS if name in whole and "temperature_degC" not in whole), None)


def not_recorded(conditions: Conditions, name: str, other: str) -> str:
    """Say that another column stands in for one, and in which runs that was not recorded, where it was in some."""
    lacking = ~np.isfinite(conditions.columns.get(name, np.full(len(conditions), np.nan)))
    some = "" if lacking.all() else f" in {numbered('run', np.unique(conditions.run[lacking]).tolist())}"
    return f"sensor {conditions.sensor.number}: {name} is not recorded{some}; {other} stands in for it"
