"""What stands in for a condition that a campaign does not record: every command that asks for it asks here."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign.data import BoolArray, Campaign, Collects, Conditions, FloatArray, known_mean
from hil.campaign.laws import slope_degC_per_min, to_come_degC
from procedures.words import numbered

OWN = "temperature_degC"
WIDEST_DEGC = 4.0
"""Values that belong to one temperature lie within this; two further apart never do."""

_STAND_INS = ("case_degC", "chamber_degC", "setpoint_degC")
"""What stands in for the unit's own temperature where that is not recorded, the best first."""
_ITS_MEAN = "the unit's mean through the same setpoint"
_AS_USUAL = "the case's, with what the two differ by in all other runs,"
_FEW = 2  # runs of which nobody can say which is the odd one

_SPELLINGS = {
    "supply_V": re.compile(r"supply|volt", re.IGNORECASE),
    "vibration_rms_g": re.compile(r"vibration|vib_", re.IGNORECASE),
    "spin_period_us": re.compile(r"(spin|rotor).*(period|_us)", re.IGNORECASE),
}
"""Conditions that effects ask for, and how else people call them."""


def with_stand_ins(campaign: Campaign) -> Campaign:
    """Give every sensor the conditions that effects ask for under the names that they ask by.

    In a run in which it is off, the unit's temperature is what its case says; in runs without it, its mean through the
    same setpoint; where that is not known either, the case's, the chamber's or the setpoint's stands in for it in all;
    other spellings of a condition are recognised. Said in the campaign's warnings.
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


@dataclass(frozen=True)
class OffItsCase:
    """A run, in `rows` (n,), in which the unit's thermometer shows `degC` more than its case, others `low` to `high`.

    `usual_degC` is their median where it is the thermometer that is off, by the air's or the setpoint; None where
    nothing tells.
    """

    run: int
    rows: BoolArray
    degC: float
    low: float
    high: float
    usual_degC: float | None


def off_its_case(conditions: Conditions) -> Iterator[OffItsCase]:
    """Yield the run, of three and more, in which a thermometer is off its unit's case as in no other.

    A unit that is still to follow its case is off it by right, so that of which no slope was recorded may be.
    """
    columns, still = conditions.columns, to_come_degC(slope_degC_per_min(conditions)) > 0.5 * WIDEST_DEGC
    if not {OWN, "case_degC"} <= columns.keys():
        return
    air = next((columns[name] for name in _STAND_INS[1:] if name in columns), np.full(len(still), np.nan))

    def of_runs(off: FloatArray) -> dict[int, float]:
        off = np.where(still, np.nan, off)
        every = {run: known_mean(off[rows]) for run, rows in conditions.of_each_run.items()}
        return {run: degC for run, degC in every.items() if np.isfinite(degC)}

    def alone(run: int, off: Mapping[int, float]) -> float:
        return abs(off[run] - float(np.median([off[each] for each in off if each != run]))) if run in off else np.nan

    known = of_runs(columns[OWN] - columns["case_degC"])
    ordered = sorted(known, key=lambda run: known[run])
    for run in {ordered[0], ordered[-1]} if len(known) > _FEW else ():
        others = [known[each] for each in known if each != run]
        low, high = min(others), max(others)
        if high - low < WIDEST_DEGC < max(low - known[run], known[run] - high):
            own, case = (alone(run, of_runs(columns[name] - air)) for name in (OWN, "case_degC"))
            rows = conditions.run == run
            steady = np.isfinite(columns.get("dTdt_degC_per_min", np.full(len(rows), np.nan))[rows]).all()
            usual = float(np.median(others)) if steady and own > case + 0.5 * WIDEST_DEGC else None
            yield OffItsCase(run, rows, known[run], low, high, usual)


def own_degC(conditions: Conditions) -> FloatArray:
    """Return what the unit's own thermometer showed (n,), or its case tells of a run in which that is off."""
    own = conditions.columns.get(OWN, np.full(len(conditions), np.nan)).copy()
    for off in off_its_case(conditions):
        if off.usual_degC is not None:
            own[off.rows] = conditions.columns["case_degC"][off.rows] + off.usual_degC
    return own


def instead_of_temperature(conditions: Conditions) -> tuple[str, FloatArray] | None:
    """Return what stands in for the unit's own temperature, in words, and it (n,); None where that, or nothing, is."""
    columns = conditions.columns
    own = own_degC(conditions)
    lacking, setpoint = np.isnan(own), columns.get("setpoint_degC", own)
    if not lacking.any():
        return (_AS_USUAL, own) if np.any(own != columns[OWN]) else None
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
    """Say what stands in for a condition, and in which runs that was not recorded, or is off, where it was in some."""
    lacking = ~np.isfinite(conditions.columns.get(name, np.full(len(conditions), np.nan)))
    off = [each.rows for each in off_its_case(conditions) if each.usual_degC is not None and name == OWN]
    what = "not recorded" if lacking.any() else "off"
    lacking = np.any([lacking, *off], axis=0)
    some = "" if lacking.all() else f" in {numbered('run', np.unique(conditions.run[lacking]).tolist())}"
    return f"sensor {conditions.sensor.number}: {name} is {what}{some}; {other} stands in for it"


def _stand_ins(conditions: Conditions) -> Iterator[tuple[str, str, FloatArray]]:
    """Yield what is not recorded, what stands in for it, and its values (n,)."""
    columns = conditions.columns
    if found := instead_of_temperature(conditions):
        yield (OWN, *found)
    for name, spelling in _SPELLINGS.items():
        others = [one for one in columns if spelling.search(one) and np.isfinite(columns[one]).all()]
        if name not in columns and len(others) == 1:
            yield name, others[0], columns[others[0]]
