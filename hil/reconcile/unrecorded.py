"""What the campaign does not record: what stands in for it, and which names could therefore not be asked about.

A name is only as sure as its rivals could be tried. A bias that rises through the night is ageing or follows a
temperature; where no temperature was recorded, both explain it equally.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.model.effects.catalogue import effect_by_id
from hil.model.effects.noise import power_cycles
from hil.reconcile.naming import Naming, Weighed, with_rivals
from hil.solve.temperatures import same_temperature
from procedures.words import listed

_TEMPERATURES = ("case_degC", "chamber_degC", "setpoint_degC")
_SPELLINGS = {
    "supply_V": re.compile(r"supply|volt", re.IGNORECASE),
    "vibration_rms_g": re.compile(r"vibration|vib_", re.IGNORECASE),
    "spin_period_us": re.compile(r"(spin|rotor).*(period|_us)", re.IGNORECASE),
}
"""Conditions that effects ask for, and how else people call them."""


def _zone(columns: FloatArray, conditions: Conditions) -> str:
    """The range of setpoints in which alone, and always, a step's bias stands; empty where no range is that."""
    temperature = conditions.columns.get("temperature_degC")
    there = np.any(columns, axis=(1, 2))
    if temperature is None or not np.all(np.isfinite(temperature)) or there.all() or not there.any():
        return ""
    inside, outside = temperature[there], temperature[~there]
    setpoint = same_temperature(conditions)
    first, last = setpoint[there].min(), setpoint[there].max()
    if np.any((setpoint[~there] >= first) & (setpoint[~there] <= last)):
        return ""
    below, above = outside[outside < inside.min()], outside[outside > inside.max()]
    if not len(above):
        return f"B × temperature_degC>{0.5 * (below.max() + inside.min()):.1f}"
    if not len(below):
        return f"B × temperature_degC<{0.5 * (above.min() + inside.max()):.1f}"
    return f"B × temperature_degC[{inside.min() - 1.0:.1f}..{inside.max() + 1.0:.1f}]"


_NO_LAW = 0.25  # what no effect describes, against what one does: 20 to 80, as in the search


def with_stand_ins(campaign: Campaign) -> Campaign:
    """Give every sensor the conditions that effects ask for under the names that they ask by.

    The case's, the chamber's or the setpoint's temperature stands in for the unit's where that is not recorded; other
    spellings of a condition are recognised. Said in the campaign's warnings.
    """
    sensors, said = dict(campaign.sensors), []
    for number, collects in campaign.sensors.items():
        conditions = collects.conditions
        found = dict(_stand_ins(conditions.columns))
        if not found:
            continue
        columns = {**conditions.columns, **{name: conditions.columns[other] for name, other in found.items()}}
        renamed = replace(conditions, columns=columns)
        sensors[number] = Collects(renamed, collects.rates_deg_per_hr, collects.rates_se_deg_per_hr)
        said += [f"sensor {number}: {name} is not recorded; {other} stands in for it" for name, other in found.items()]
    return replace(campaign, sensors=sensors, warnings=[*campaign.warnings, *said]) if said else campaign


def _stand_ins(columns: Mapping[str, FloatArray]) -> Iterator[tuple[str, str]]:
    """Yield what is not recorded, with the column that stands in for it."""
    if not _known(columns.get("temperature_degC")):
        other = next((name for name in _TEMPERATURES if _known(columns.get(name))), None)
        if other is not None:
            yield "temperature_degC", other
    for name, spelling in _SPELLINGS.items():
        others = [one for one in columns if spelling.search(one) and _known(columns[one])]
        if name not in columns and len(others) == 1:
            yield name, others[0]


def _known(values: FloatArray | None) -> bool:
    return values is not None and bool(np.all(np.isfinite(values)))


def _cycles_are_setpoints(conditions: Conditions) -> bool:
    """Whether each power cycle stood at one setpoint, which no other cycle visited."""
    pairs = set(zip(same_temperature(conditions).tolist(), power_cycles(conditions).tolist(), strict=True))
    return len(pairs) == len({setpoint for setpoint, _ in pairs}) == len({cycle for _, cycle in pairs})


@dataclass(frozen=True)
class _Unasked:
    """A name beside the leader: what would tell them apart, and how probable it is before the data, the leader's 1."""

    name: str
    title: str
    remedy: str
    weight: float = 1.0
    tier: int = 1


def beside_unasked(naming: Naming, conditions: Mapping[int, Conditions]) -> Naming:
    """Share a name's probability with those of the same history that this data leaves unasked."""
    leader = naming.leader
    if leader.tier != 1:
        return naming
    unasked = list(_unasked(leader, conditions[leader.added.hypothesis.candidate.sensor]))
    if not unasked:
        return naming
    share = 1.0 / (1.0 + sum(one.weight for one in unasked))
    others = [
        replace(
            leader,
            name=one.name,
            title=one.title,
            tier=one.tier,
            probability=leader.probability * share * one.weight,
            overlap=1.0,
            remedy=one.remedy,
        )
        for one in unasked
    ]
    return with_rivals(naming, share, others)


def _unasked(leader: Weighed, here: Conditions) -> Iterator[_Unasked]:
    """Yield the names of the leader's history in time that nothing recorded tells from it."""
    candidate = leader.added.hypothesis.candidate
    kin = {} if leader.effect is None else leader.effect.kin_for(here, candidate.shape)
    for name, weight in kin.items():
        effect = effect_by_id(name)
        needs = effect.missing(here)
        if needs:
            remedy = f"record {listed(need.replace('|', ' or ') for need in needs)}"
            yield _Unasked(name, effect.title, remedy, weight)
    if candidate.shape.get("runs_held"):
        yield _Unasked("turnon", "Turn-on bias", "repeat the run; a state of the bearing comes back, scatter does not")
    if leader.name == "turnon" and _cycles_are_setpoints(here):
        yield _Unasked("bias_T", effect_by_id("bias_T").title, "several power cycles at one temperature")
    zone = _zone(candidate.columns, here) if leader.name == "jump" else ""
    if zone:
        title = f"Bias follows {zone.removeprefix('B × ')}"
        yield _Unasked(zone, title, "visit the temperatures in another order", _NO_LAW, 2)
