"""What the campaign does not record: what stands in for it, and which names could therefore not be asked about.

A name is only as sure as its rivals could be tried. A bias that rises through the night is ageing or follows a
temperature; where no temperature was recorded, both explain it equally.
"""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.campaign import Campaign, Collects, Conditions
from hil.campaign.warnings import instead_of_temperature, not_recorded
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile.naming import Named
from hil.reconcile.result import Rival
from hil.reconcile.search.fitted import Fitted
from procedures.words import listed

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


def beside_unasked(named: Named, fit: Fitted) -> Named:
    """Share a name's probability with those of the same history in time that this data leaves unasked."""
    if not named.terms or not isinstance(named.effect, Effect):
        return named
    number, places = next(iter(named.terms.items()))
    here, own = fit.conditions[number], named.effect if named.name == named.effect.id else effect_by_id(named.name)
    kin = own.kin_for(here, fit.posterior.term(number, places[0]).candidate.shape)
    unasked: list[tuple[Effect, float, str]] = []
    for name, weight in kin.items():
        effect = effect_by_id(name)
        needs = effect.missing(here)
        if needs or not effect.shape_grid(here):
            record = [f"record {listed(need.replace('|', ' or ') for need in needs)}"] if needs else []
            unasked.append((effect, weight, record[0] if record else effect.experiment))
    aliases = own.aliases_for(here).items()
    unasked += [(effect_by_id(name), weight, own.experiment) for name, weight in aliases]
    if not unasked:
        return named
    share = 1.0 / (1.0 + sum(weight for _, weight, _ in unasked))
    others = [
        Rival(effect.id, named.probability * share * weight, 1.0, effect.title, 1.0, weight, remedy=remedy)
        for effect, weight, remedy in unasked
    ]
    rivals = sorted([*named.rivals, *others], key=lambda r: -r.probability)
    return replace(named, probability=named.probability * share, rivals=rivals, kind="ambiguous")
