"""What stands in for conditions that are not recorded: other thermometers, and other spellings of a name."""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.campaign import Campaign, Conditions
from hil.campaign.warnings import instead_of_temperature, not_recorded

_SPELLINGS = {
    "supply_V": re.compile(r"supply|volt", re.IGNORECASE),
    "vibration_rms_g": re.compile(r"vibration|vib_", re.IGNORECASE),
    "spin_period_us": re.compile(r"(spin|rotor).*(period|_us)", re.IGNORECASE),
}
"""Conditions that effects ask for, and how else people call them."""


def with_stand_ins(campaign: Campaign) -> Campaign:
    """Give every sensor the conditions that effects ask for under the names that they ask by; its warnings say so."""
    every = {number: collects.conditions for number, collects in campaign.sensors.items()}
    said = [not_recorded(own, name, other) for own in every.values() for name, other in _stand_ins(own)]
    if not said:
        return campaign
    sensors = {n: replace(collects, conditions=stood_in(every[n])) for n, collects in campaign.sensors.items()}
    return replace(campaign, sensors=sensors, warnings=list(dict.fromkeys([*campaign.warnings, *said])))


def stood_in(conditions: Conditions) -> Conditions:
    """Return conditions with what stands in for those that effects ask for and that are not recorded.

    The case's, the chamber's or the setpoint's temperature does for the unit's; other spellings are recognised.
    """
    found = {name: conditions.columns[other] for name, other in _stand_ins(conditions)}
    return replace(conditions, columns={**conditions.columns, **found}) if found else conditions


def _stand_ins(conditions: Conditions) -> Iterator[tuple[str, str]]:
    """Yield what is not recorded, with the column that stands in for it."""
    columns = conditions.columns
    if other := instead_of_temperature(conditions):
        yield "temperature_degC", other
    for name, spelling in _SPELLINGS.items():
        others = [one for one in columns if spelling.search(one) and np.isfinite(columns[one]).all()]
        if name not in columns and len(others) == 1:
            yield name, others[0]
