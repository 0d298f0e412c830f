"""Which rows of a sensor are fitted against temperature, in which form, and which temperatures those are."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hil.analysis.thermal.estimate import Layout, Stations, find_stations, visits
from hil.campaign import Collects
from hil.errors import InputError
from hil.model.forms import LinearForm, default_form, named_form
from hil.solve import solve
from hil.solve.runs import OBSERVABLE
from hil.solve.temperatures import same_temperature
from procedures.words import counted

_MOVES_DEGC = 0.1  # half the range of a thermometer that tells anything


def layout_of(
    number: int, collects: Collects, model_name: str | None, apart_degC: float | None, factor_of: Mapping[str, float]
) -> tuple[Layout, list[str]]:
    """Choose the form and the rows: temperatures at which no run tells every parameter are left out.

    Raises `InputError` where fewer than three temperatures are left.
    """
    collects, notes = _at_known_temperatures(number, collects, apart_degC)
    stations = find_stations(collects.conditions, apart_degC)
    form = named_form(model_name, collects.conditions) if model_name else default_form(collects.conditions)
    if form.reason:
        notes.append(f"sensor {number}: {form.reason}")
    factor = np.array([factor_of.get(name, 1.0) for name in form.names])
    run = collects.conditions.run
    tell = {each for each in np.unique(run).tolist() if _tells_all(form, collects.rows(run == each))}
    whole = np.array([not tell.isdisjoint(run[stations.number == place].tolist()) for place in range(len(stations))])
    spread = None
    if not np.all(whole):
        left = ", ".join(f"{each:.1f} °C" for each in stations.centre_degC[~whole])
        notes.append(f"sensor {number}: no run tells every parameter at {left}; left out")
        columns = form.columns(collects.conditions)
        spread = visits(Layout(collects, form, columns, stations, 0.0, 1.0, False, factor)).spread
        keep = whole[stations.number]
        collects = collects.rows(keep)
        number_of = np.cumsum(whole) - 1
        stations = Stations(number_of[stations.number[keep]], stations.centre_degC[whole], stations.direction[keep])
    if len(stations) < 3:
        raise InputError(
            f"sensor {number}: {counted(len(stations), 'temperature')} with every parameter; at "
            "least three are needed (--apart says how far apart two temperatures are)"
            + "".join(f"; {note.removeprefix(f'sensor {number}: ')}" for note in notes)
        )
    own = collects.conditions.columns["temperature_degC"]
    middle, half = 0.5 * float(own.min() + own.max()), 0.5 * float(np.ptp(own))
    if half < _MOVES_DEGC:
        shown = f"temperature_degC is {own.mean():.1f} °C at every setpoint"
        raise InputError(f"sensor {number}: {shown}; nothing can be said against it: look at that column")
    both = len(stations.both_directions) > 0
    if both:
        middles = "values are the middle between both directions; without their difference, which the means and ± of"
        notes.append(f"sensor {number}: {middles} hil solve hold")
    columns = form.columns(collects.conditions)
    layout = Layout(collects, form, columns, stations, float(np.round(middle)), half, both, factor, spread)
    return layout, notes


def _at_known_temperatures(number: int, collects: Collects, apart_degC: float | None) -> tuple[Collects, list[str]]:
    """Take rows without the unit's temperature at its mean through the same setpoint, or leave them out; say so."""
    conditions = collects.conditions
    shown = conditions.columns.get("temperature_degC", np.zeros(0))
    known = np.isfinite(shown)
    if known.all() or not known.any():
        return collects, []
    at, filled = same_temperature(conditions, apart_degC), shown.copy()
    for place in np.unique(at[known]).tolist():
        filled[(at == place) & ~known] = shown[(at == place) & known].mean()
    left, taken = np.isnan(filled), ~known & np.isfinite(filled)
    columns = {**conditions.columns, "temperature_degC": filled}
    said = [
        f"sensor {number}: {counted(int(rows.sum()), 'row')} without temperature: {what}"
        for rows, what in ((taken, "taken at the unit's mean through the same setpoint"), (left, "left out"))
        if rows.any()
    ]
    return replace(collects, conditions=replace(conditions, columns=columns)).rows(~left), said


def _tells_all(form: LinearForm, collects: Collects) -> bool:
    columns = form.columns(collects.conditions)
    rates = collects.rates_deg_per_hr.reshape(-1)
    found = solve(
        columns.reshape(len(rates), -1), np.where(np.isnan(rates), np.nan, 0.0), 1.0, rank_tolerance=OBSERVABLE
    )
    return int(found.rank) == len(form.names)
