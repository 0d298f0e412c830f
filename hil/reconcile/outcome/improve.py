"""The model with what was found: named terms with value, uncertainty, unit, and where they came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hil.campaign import Conditions
from hil.model import Model, Term
from hil.model.curve import Constant, Polynomial, Table, TableRows
from hil.model.effects.empirical import empirical
from hil.model.effects.followed import driver_reference
from hil.model.forms import LinearForm, matrix_6_form, triad_12_form
from hil.reconcile.search.calibration import PerTemperatureForm
from hil.reconcile.search.candidates import POWERS, Candidate
from hil.reconcile.search.fit import Added, Fit
from hil.reconcile.search.hypotheses import Unit
from hil.reconcile.search.problem import SensorProblem

Curve = Constant | Polynomial | Table


def described_parameters(
    index: int, added: Added, fit: Fit, conditions: Mapping[int, Conditions]
) -> list[dict[str, Any]]:
    """Return the fitted parameters of one added effect, for the result document."""
    out = []
    for place, (owner, u, k) in enumerate(fit.owner):
        if owner != index:
            continue
        unit = added.units[u]
        candidate = unit.candidate
        number = unit.parameters[k]
        parameter = candidate.parameters[number]
        if fit.covariance[place, place] <= 0.0:
            continue  # the base can imitate it altogether: these collects give it no value
        power, at = _place(candidate, number)
        entry: dict[str, Any] = {
            "name": parameter.name,
            "value": float(fit.values[place]),
            "se": float(np.sqrt(max(fit.covariance[place, place], 0.0))),
            "unit": parameter.unit + _power_unit(power),
            "at": at or _range(conditions[candidate.sensor]),
            "sensor": candidate.sensor,
        }
        if candidate.tier == 2:
            entry["name"] = f"{_base_parameter(candidate, unit, number, conditions)} × {candidate.driver}"
        out.append(entry)
    return out


def _place(candidate: Candidate, number: int) -> tuple[int, str]:
    """Which power of temperature, or which setpoint, a column's value belongs to."""
    if candidate.form == "constant":
        return 0, ""
    repeats = POWERS.get(candidate.form, len(candidate.stations_degC))
    part = number // (candidate.size // repeats)
    if candidate.form == "table":
        return 0, f"{candidate.stations_degC[part]:.1f} degC"
    return part, f"about {candidate.reference_degC:g} degC"


def _power_unit(power: int) -> str:
    return {0: "", 1: "/degC"}.get(power, f"/degC^{power}")


def _range(conditions: Conditions) -> str:
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.any(np.isfinite(temperature)):
        return "the campaign's temperature (not recorded)"
    low, high = float(np.nanmin(temperature)), float(np.nanmax(temperature))
    return f"{low:.1f} degC" if high - low < 1.0 else f"{low:.1f} to {high:.1f} degC"


def improved(
    model: Model,
    sensors: Mapping[int, SensorProblem],
    added: Sequence[Added],
    fit: Fit,
    values: Mapping[int, np.ndarray[Any, Any]],
    record: Sequence[Mapping[str, Any]],
) -> Model:
    """Return the model with the added terms; a built-in gets the base values that were fitted with them.

    `values` are the refitted base parameters, (p,), by sensor, `record` says where each term came from.
    """
    terms = list(model.terms)
    for index, effect in enumerate(added):
        for number in sorted({unit.candidate.sensor for unit in effect.units}):
            terms += _terms(index, number, effect, fit, sensors[number], record[index])
    base = {
        number: _base_curves(sensor.form, values[number])
        if sensor.given is None
        else _shifted(model.sensors[number], sensor.form, values[number])
        for number, sensor in sensors.items()
    }
    comparable = all(sensor.form.name in {model.form, "matrix-6"} for sensor in sensors.values())
    changes: dict[str, Any] = {"terms": tuple(terms), "version": model.version + 1}
    if comparable:
        changes["sensors"] = {**model.sensors, **base}
    return model.model_copy(update=changes)


def _base_curves(form: LinearForm, values: np.ndarray[Any, Any]) -> dict[str, Curve]:
    if isinstance(form, PerTemperatureForm):
        own = values.reshape(len(form.plain_names), len(form.centres_degC))
        return {
            name: Table(unit=unit, table=TableRows(temperature_degC=form.centres_degC, value=tuple(map(float, row))))
            for name, unit, row in zip(form.plain_names, form.plain_units, own, strict=True)
        }
    if form.reference_degC is None:
        return {n: Constant(unit=u, value=float(v)) for n, u, v in zip(form.names, form.units, values, strict=True)}
    return {
        form.names[i]: Polynomial(
            unit=form.units[i],
            polynomial=tuple(float(v) for v in values[i : i + 3]),
            reference_degC=form.reference_degC,
        )
        for i in range(0, len(form.names), 3)
    }


def _shifted(given: Mapping[str, Curve], form: LinearForm, values: np.ndarray[Any, Any]) -> dict[str, Curve]:
    """Return the curves that stood, each with its fitted correction."""
    out: dict[str, Curve] = {}
    for name, correction in zip(form.names, values, strict=True):
        curve, shift = given[name], float(correction)
        if isinstance(curve, Polynomial):
            change: dict[str, Any] = {"polynomial": (curve.polynomial[0] + shift, *curve.polynomial[1:])}
        elif isinstance(curve, Table):
            rows = curve.table.model_copy(update={"value": tuple(v + shift for v in curve.table.value)})
            change = {"table": rows}
        else:
            change = {"value": curve.value + shift}
        out[name] = curve.model_copy(update=change)
    return out


def _terms(
    index: int, number: int, added: Added, fit: Fit, sensor: SensorProblem, record: Mapping[str, Any]
) -> list[Term]:
    """Return the terms of one added effect on one sensor."""
    found: dict[int, tuple[float, float]] = {}
    candidate: Candidate | None = None
    units: dict[int, Unit] = {}
    for place, (owner, u, k) in enumerate(fit.owner):
        if owner != index:
            continue
        unit = added.units[u]
        if unit.candidate.sensor == number:
            candidate = unit.candidate
            column = unit.parameters[k]
            units[column] = unit
            found[column] = (float(fit.values[place]), float(np.sqrt(max(fit.covariance[place, place], 0.0))))
    if candidate is None:
        return []
    if candidate.tier == 2:
        return _empirical_terms(candidate, units, found, sensor, record)
    if candidate.effect is None:
        return []
    curves = _curves(candidate, found)
    return [
        Term(
            effect=candidate.effect.id,
            sensor=number,
            parameters=curves,
            shape=dict(candidate.shape),
            added=dict(record),
        )
    ]


def _curves(candidate: Candidate, found: Mapping[int, tuple[float, float]]) -> dict[str, Curve]:
    """Return one curve per parameter, in the candidate's form."""
    if candidate.form == "constant":
        return {
            candidate.parameters[k].name: Constant(unit=candidate.parameters[k].unit, value=value, se=error)
            for k, (value, error) in found.items()
        }
    repeats = POWERS.get(candidate.form, len(candidate.stations_degC))
    own = candidate.size // repeats
    curves: dict[str, Curve] = {}
    for first in sorted({k % own for k in found}):
        pairs = [found.get(first + own * part, (0.0, 0.0)) for part in range(repeats)]
        parameter = candidate.parameters[first]
        values, errors = tuple(p[0] for p in pairs), tuple(p[1] for p in pairs)
        if candidate.form == "table":
            rows = TableRows(temperature_degC=candidate.stations_degC, value=values, se=errors)
            curves[parameter.name] = Table(unit=parameter.unit, table=rows)
        else:
            curves[parameter.name] = Polynomial(
                unit=parameter.unit, polynomial=values, reference_degC=candidate.reference_degC or 0.0, se=errors
            )
    return curves


def _empirical_terms(
    candidate: Candidate,
    units: Mapping[int, Unit],
    found: Mapping[int, tuple[float, float]],
    sensor: SensorProblem,
    record: Mapping[str, Any],
) -> list[Term]:
    """Return one term per channel and power: base parameter × driver, with the sign of the parameter's own column."""
    conditions = sensor.collects.conditions
    out = []
    for column, (value, error) in found.items():
        channel, power = _channel_and_power(candidate, column, conditions)
        name = _parameter_of(candidate, channel, conditions)
        driver = candidate.driver if power is None else f"{candidate.driver}^{power}"
        effect = empirical(name, driver)
        reference = driver_reference(driver, conditions)
        own = effect.columns(conditions, None, {"reference": reference})[:, channel, 0]
        mine = units[column].candidate.columns[:, channel, column]
        scale = float(own @ mine) / max(float(own @ own), 1e-300)
        if name != "w":
            parameter = Constant(
                unit=effect.parameters_for(conditions)[0].unit, value=value * scale, se=abs(error * scale)
            )
        else:
            parameter = Constant(unit=f"1 per {driver}", value=value * scale, se=abs(error * scale))
        out.append(
            Term(
                effect=effect.id,
                sensor=sensor.number,
                parameters={"q": parameter},
                shape={"reference": reference},
                added=dict(record),
            )
        )
    return out


def _channel_and_power(candidate: Candidate, column: int, conditions: Conditions) -> tuple[int, int | None]:
    channels = len(conditions.sensor.channels)
    order = candidate.size // channels
    return (column, None) if order == 1 else (column // order, column % order + 1)


def _parameter_of(candidate: Candidate, channel: int, conditions: Conditions) -> str:
    """Return the base parameter that a second-tier term of a channel changes."""
    sensor = conditions.sensor
    axis = list(sensor.channels.values())[channel]
    if candidate.target == "B":
        return f"B{axis}"
    if candidate.target == "earth rate":
        return "w"
    if sensor.is_rotor:
        form = matrix_6_form(sensor)
        names = {"MU": ("MUB", "MUA"), "GS": ("GSA", "GSB")}.get(candidate.target, ("GSB", "GSA"))
        return names[channel] if names[channel] in form.names else form.names[channel]
    if sensor.is_triad and candidate.target.startswith("g along "):
        name = f"G{axis}{candidate.target.removeprefix('g along ')}"
        return name if name in triad_12_form(sensor).names else f"B{axis}"
    return f"B{axis}"


def _base_parameter(candidate: Candidate, unit: Unit, column: int, conditions: Mapping[int, Conditions]) -> str:  # noqa: ARG001
    rows = conditions[candidate.sensor]
    return _parameter_of(candidate, _channel_and_power(candidate, column, rows)[0], rows)
