"""What stands in for a condition that a campaign does not record: every command that asks for it asks here."""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.campaign.data import Campaign, Collects, Conditions, FloatArray
from procedures.words import numbered

OWN = "temperature_degC"
WIDEST_DEGC = 4.0
"""Values that belong to one temperature lie within this; two further apart never do."""

_STAND_INS = ("case_degC", "chamber_degC", "setpoint_degC")
"""What stands in for the unit's own temperature where that is not recorded, the best first."""
_ITS_MEAN = "the unit's mean through the same setpoint"

_SPELLINGS = {
    "supply_V": re.compile(r"supply|volt", re.IGNORECASE),
    "vibration_rms_g": re.compile(r"vibration|vib_", re.IGNORECASE),
    "spin_period_us": re.compile(r"(spin|rotor).*(period|_us)", re.IGNORECASE),
}
"""Conditions that effects ask for, and how else people call them."""


def with_stand_ins(campaign: Campaign) -> Campaign:
    """Give every sensor the conditions that effects ask for under the names that they ask by.

    In runs without it the unit's temperature is its mean through the same setpoint; where that is not known either, the
    case's, the chamber's or the setpoint's stands in for it in all; other spellings of a condition are recognised. Said
    in the campaign's warnings.
    """
    sensors, said = dict(campaign.sensors), []
    for number, collects in campaign.sensors.items():
        conditions, found = collects.conditions, {}
        for name, other, values in _stand_ins(conditions):
            found[name] = values
            said.append(not_recorded(conditions, name, other))
        renamed = replace(conditions, columns={**conditions.columns, **found})
        sensors[number] = Collects(renamed, collects.rates_deg_per_hr, collects.rates_se_deg_per_hr)
    warnings = list(dict.fromkeys([*campaign.warnings, *said]))
    return replace(campaign, sensors=sensors, warnings=warnings) if said else campaign


def instead_of_temperature(conditions: Conditions) -> tuple[str, FloatArray] | None:
    """Return what stands in for the unit's own temperature, in words, and it (n,); None where that, or nothing, is."""
    columns = conditions.columns
    own = columns.get(OWN, np.full(len(conditions), np.nan)).copy()
    lacking, setpoint = np.isnan(own), columns.get("setpoint_degC", own)
    if not lacking.any():
        return None
    for degC in np.unique(setpoint[lacking]):
        if (known := (setpoint == degC) & ~lacking).any():
            own[lacking & (setpoint == degC)] = own[known].mean()
    if np.isfinite(own).all():
        return _ITS_MEAN, own
    return next(((name, columns[name]) for name in _STAND_INS if np.isfinite(columns.get(name, np.nan)).all()), None)


def told(conditions: Conditions) -> tuple[str, FloatArray]:
    """Return what tells the unit's temperature, and it (n,): its own, or what stands in for it; NaN where nothing."""
    own = conditions.columns.get(OWN, np.full(len(conditions), np.nan))
    return instead_of_temperature(conditions) or (OWN, own)


def temperature_of(conditions: Conditions) -> str:
    """Return the column that the unit's temperature is taken from: its own, or what stands in for it."""
    own, columns = conditions.columns.get(OWN), conditions.columns
    same = (name for name in _STAND_INS if own is not None and np.array_equal(own, columns.get(name, ())))
    return next(same, OWN)


def not_recorded(conditions: Conditions, name: str, other: str) -> str:
    """Say what stands in for a condition, and in which runs that was not recorded, where it was in some."""
    lacking = ~np.isfinite(conditions.columns.get(name, np.full(len(conditions), np.nan)))
    some = "" if lacking.all() else f" in {numbered('run', np.unique(conditions.run[lacking]).tolist())}"
    return f"sensor {conditions.sensor.number}: {name} is not recorded{some}; {other} stands in for it"


def _stand_ins(conditions: Conditions) -> Iterator[tuple[str, str, FloatArray]]:
    """Yield what is not recorded, what stands in for it, and its values (n,)."""
    columns = conditions.columns
    if found := instead_of_temperature(conditions):
        yield (OWN, *found)
    for name, spelling in _SPELLINGS.items():
        others = [one for one in columns if spelling.search(one) and np.isfinite(columns[one]).all()]
        if name not in columns and len(others) == 1:
            yield name, others[0], columns[others[0]]
