"""What is suspicious in a campaign but legal: imported, said, and repeated by every report."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hil.campaign.data import EARTH_RATE_DEG_PER_HR, TELL_TEMPERATURE, BoolArray, Campaign, Collects, Conditions
from hil.campaign.header import OF_A_SENSOR, Header
from hil.campaign.plausibility import accelerations_g
from hil.campaign.stand_ins import OWN, instead_of_temperature, not_recorded
from hil.campaign.table import Table, rows_in_words
from procedures.words import listed, numbered

F_LIMITS_G = (0.5, 1.5)
"""Beyond these |f| is no static collect, unless the campaign says that a centrifuge was used."""

F_SUSPICIOUS = 0.02

NO_EARTH = (
    "w is 0 in every row: what there is of the earth rate (15 deg/hr) is in the parameters; fill w_* by latitude and "
    "heading"
)
_LEVEL_DEG_PER_HR = 0.1
"""A horizontal part of the earth rate that is less counts as none."""

_LEANS, _LEANS_G = 5.0, (0.02, 0.1)
"""Times as far off f as at most positions, and between what: less moves hardly a rate, and more `plausibility` says."""
_POSITIONS = 4

_FAR_DEGC = 3.0
"""Further than a chamber holds its air off the setpoint that it has reached."""

_USUAL_DEGC = (-100.0, 100.0)
"""Beyond these a temperature is rather in K or °F."""


def suspicions(
    table: Table,
    header: Header,
    sensors: Mapping[int, Collects],
    lines: Mapping[int, Sequence[int]],
    undeclared: Sequence[str],
) -> tuple[str, ...]:
    """Return one sentence for each suspicion, with the file and the rows; `lines` gives each sensor's row numbers."""
    found = [
        f"{table.path.with_name('campaign.yaml')}, key {key}: not known, so not used"
        + f"; it belongs to a sensor: sensors.{min(header.sensors)}.{key}" * (key in OF_A_SENSOR)
        for key in header.extra
    ]
    found += [f"{table.path}: sensor {n} is described but has no row" for n in header.sensors if n not in sensors]
    lost = sorted({*header.campaign.verdicts}.difference(table.integers("run").tolist()))
    judged = f"{numbered('run', lost)}, which campaign.yaml judges, {'has' if len(lost) == 1 else 'have'} no row"
    found += [f"{table.path}: {judged}: what they measured is missing here"] if lost else []
    found += [
        f"{table.path}, column {name}: campaign.yaml does not say under conditions what it is; taken as a condition"
        for name in undeclared
    ]
    backwards = np.flatnonzero(np.diff(table.numbers("start_s")) < 0.0) + 1
    if len(backwards):
        rows = rows_in_words(np.take(table.rows, backwards))
        found.append(f"{table.path}, {rows}, column start_s: earlier than the row before; rows should be chronological")
    for number, collects in sensors.items():
        found += _of_sensor(f"{table.path}, sensor {number}", collects, np.asarray(lines[number]), header.campaign)
    found += _zero_errors(table, sensors, lines)
    return tuple(found)


def _of_sensor(where: str, collects: Collects, rows: np.ndarray, said: Campaign) -> list[str]:
    def at(chosen: np.ndarray) -> str:
        return f"{where}, {rows_in_words(rows[chosen])}"

    found = []
    conditions = collects.conditions
    if np.any(off := off_gravity(conditions)) and not said.centrifuge:
        found.append(f"{at(off)}: {off_in_words(conditions)}")
    runs, told = len(np.unique(conditions.run)), {*TELL_TEMPERATURE} & {*conditions.columns}
    if runs > 1 and not any(np.isfinite(conditions.columns[name]).any() for name in told):
        found.append(
            f"{where}: none of the columns {listed(TELL_TEMPERATURE)} has a temperature: all {runs} runs count as made "
            "at one, and what follows temperature as scatter"
        )
    for name, values in conditions.columns.items():
        low, high = _USUAL_DEGC
        if name.endswith("_degC") and np.any(odd := (values < low) | (values > high)):
            worst = values[odd][np.argmax(np.abs(values[odd]))]
            found.append(f"{at(odd)}, column {name}: {worst:.4g} °C; is that column in °C?")
    if other := instead_of_temperature(conditions):
        found.append(not_recorded(conditions, OWN, other[0]))
    elif (lacking := np.isnan(conditions.columns.get(OWN, np.zeros(len(conditions))))).any() and not lacking.all():
        found.append(f"{at(lacking)}: no {OWN}, and nothing that stands in for it: nothing there is asked to follow it")
    found += [f"{at(there)}: {words}" for there, words in _not_reached(conditions)]
    if said.centrifuge or said.rebuilt:
        return found
    found += [f"{where}: {each}" for each in _leaning(collects)]
    if not conditions.w_deg_per_hr.any():
        found.append(f"{where}: {NO_EARTH}")
    elif (across := _across(conditions)) > _LEVEL_DEG_PER_HR:
        found.append(
            f"{where}: w is the vertical part of the earth rate: the horizontal part, up to {across:.1f} deg/hr in "
            "any channel, is in the rates, and in no standard error"
        )
    return found


def _not_reached(conditions: Conditions) -> Iterator[tuple[BoolArray, str]]:
    """Yield the rows (n,) at a setpoint that the chamber's own air was far from, with what it was at."""
    none = np.full(len(conditions), np.nan)
    air, set_to = (conditions.columns.get(name, none) for name in ("chamber_degC", "setpoint_degC"))
    for setpoint in np.unique(set_to[np.isfinite(air) & np.isfinite(set_to)]).tolist():
        there = set_to == setpoint
        shown = float(np.nanmedian(air[there]))
        if abs(shown - setpoint) > _FAR_DEGC:
            was = f"the air was at {shown:z.1f} °C where {setpoint:z.4g} °C was set, which was not reached"
            yield there, f"{was}: what is said of {setpoint:z.4g} °C is of what the unit had there"


def _leaning(collects: Collects) -> Iterator[str]:
    """Say of a position that the unit's accelerometers are further off f there than at others: f is what should be."""
    conditions, off = collects.conditions, np.linalg.norm(accelerations_g(collects) - collects.conditions.f_g, axis=1)
    measured = np.isfinite(off)
    labels = np.unique(conditions.position[measured]).tolist()
    if len(labels) < _POSITIONS:
        return
    size = np.array([np.median(off[measured & (conditions.position == label)]) for label in labels])
    usual, (least, most) = float(np.median(size)), _LEANS_G
    for label, of in zip(labels, size.tolist(), strict=True):
        if max(least, _LEANS * usual) < of < most:
            yield (
                f"at position {label} the accelerometers are {1000.0 * of:.0f} mg off f, at most others "
                f"{1000.0 * usual:.0f} mg: the unit lies there by {math.degrees(of):.1f}° otherwise than f says, and "
                "every parameter per g has that"
            )


def off_gravity(conditions: Conditions) -> BoolArray:
    """Return the rows (n,) whose |f| is no gravity's, which is what a unit at rest feels."""
    return np.asarray(np.abs(np.linalg.norm(conditions.f_g, axis=-1) - 1.0) > F_SUSPICIOUS)


def off_in_words(conditions: Conditions) -> str:
    """Say by how much |f| is off in the worst row."""
    size = np.linalg.norm(conditions.f_g, axis=-1)
    return f"|f| is off 1 g by more than 2 % (the worst is {size[np.argmax(np.abs(size - 1.0))]:.3f} g)"


def _across(conditions: Conditions) -> float:
    """Return how large the earth rate's horizontal part is, deg/hr, where w is the vertical part in every row; or 0."""
    up = conditions.f_g / np.maximum(np.linalg.norm(conditions.f_g, axis=1, keepdims=True), F_SUSPICIOUS)
    vertical = np.sum(conditions.w_deg_per_hr * up, axis=1)
    if np.abs(conditions.w_deg_per_hr - vertical[:, None] * up).max() > _LEVEL_DEG_PER_HR:
        return 0.0
    return math.sqrt(max(EARTH_RATE_DEG_PER_HR**2 - float(np.mean(vertical)) ** 2, 0.0))


def _zero_errors(table: Table, sensors: Mapping[int, Collects], lines: Mapping[int, Sequence[int]]) -> list[str]:
    found, lacking = [], dict[tuple[str, ...], list[int]]()
    for number, collects in sensors.items():
        here = np.isin(table.rows, lines[number])
        names = [f"{channel}_se_deg_per_hr" for channel in collects.conditions.sensor.channels]
        stated = {name: table.numbers(name)[here] for name in names if name in table.header}
        none = tuple(name for name in names if name not in stated or not np.any(stated[name] > 0.0))
        if 0 < len(none) < len(names):
            lacking.setdefault(none, []).append(number)
        for name, error in stated.items():
            rates, some = table.numbers(name.replace("_se_", "_"))[here], bool(np.any(error > 0.0))
            instead = "; the largest of the others stands for it" * some
            for rows, what in (
                (error == 0.0, "a standard error of 0 is taken as not stated"),
                (np.isnan(error) & np.isfinite(rates) & some, "no standard error is stated"),
            ):
                if rows.any():
                    where = rows_in_words(np.asarray(table.rows)[here][rows])
                    found.append(f"{table.path}, {where}, column {name}: {what}{instead}")
    none_of = [
        f"{table.path}: there is nothing in {listed(names)}: no standard error of {numbered('sensor', of)} is used"
        for names, of in lacking.items()
    ]
    return none_of + found
