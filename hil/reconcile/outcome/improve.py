"""The model with what was found: named terms with value, uncertainty, unit, and where they came from."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import stdtr, stdtrit

from hil.campaign import BoolArray, Conditions, FloatArray
from hil.campaign.stand_ins import temperature_of
from hil.files.numbers import WHOSE
from hil.model import Model, Term
from hil.model.curve import Constant, Curve, Polynomial, Table, TableRows
from hil.model.effects.catalogue import named as known_as
from hil.model.effects.empirical import EmpiricalTerm
from hil.model.effects.followed import driver_reference
from hil.model.stated_noise import ScatterTerm, SensorNoise
from hil.reconcile.outcome.scatter import FoundScatter
from hil.reconcile.search.candidates import POWERS, Candidate
from hil.reconcile.search.fitted import Values
from hil.reconcile.search.noise import FEWEST_RUNS
from hil.reconcile.search.problem import SensorProblem, fit_to
from hil.solve.temperatures import same_temperature
from hil.solve.uncertain import CONFIDENCE

_ONE_SE = 0.6827  # of a normal distribution lies within one standard error


def described_parameters(
    candidate: Candidate, values: Values, conditions: Conditions, shapes: Sequence[tuple[float, Values]]
) -> list[dict[str, Any]]:
    """Return the fitted parameters of one effect on one sensor, for the result document.

    `shapes` are what the values are in every shape that it may have, and how probable that is: a value is known no
    better than its shape. Intervals are Student's: what changes from run to run is known no better than so many runs
    tell it.
    """
    out, runs = [], len(np.unique(conditions.run))
    freedom = (runs if runs >= FEWEST_RUNS else len(conditions)) - 1
    for number, (value, error) in sorted(values.items()):
        low, high = _within(shapes, number, max(freedom, 1), CONFIDENCE)
        if len(shapes) > 1:
            error = 0.5 * float(np.ptp(_within(shapes, number, len(conditions), _ONE_SE)))
        parameter = candidate.parameters[number]
        power, at = _place(candidate, number)
        within = _range(conditions, np.any(candidate.columns[:, :, number], axis=1))
        place = f"{within}, {at}" if at.startswith("about") else at or within
        entry: dict[str, Any] = {
            "name": _coefficient(candidate, parameter.name, power),
            "value": value,
            "se": error,
            "low": low,
            "high": high,
            "unit": parameter.unit + {0: "", 1: "/degC"}.get(power, f"/degC^{power}"),
            "at": f"{place} ({WHOSE[temperature_of(conditions)]})" if place.endswith("degC") else place,
            "sensor": candidate.sensor,
        }
        called = () if candidate.effect is None else known_as(candidate.effect).parameters
        typical = {each.unit: each.typical for each in called} | {parameter.unit: parameter.typical}
        if candidate.tier == 1 and entry["unit"] in typical:
            entry["typical"] = typical[entry["unit"]]
        if candidate.tier == 2:
            channel, _ = _channel_and_power(candidate, number)
            own = [n for n in values if _channel_and_power(candidate, n)[0] == channel]
            whole = sum(values[n][0] * candidate.columns[:, channel, n] for n in own)
            entry["moves_deg_per_hr"] = float(np.ptp(whole))
            entry["moves_se_deg_per_hr"] = abs(error / value) * float(np.ptp(whole)) if len(own) == 1 else None
        out.append(entry)
    return out


def _coefficient(candidate: Candidate, name: str, power: int) -> str:
    """Return what the coefficient of a power of temperature is called, as in the catalogue: GSA1, b1_A, G1_XY."""
    if power == 0:
        return name
    head, *label = name.split("_", 1)
    own = f"{head}{power}"
    known = () if candidate.effect is None else known_as(candidate.effect).parameters
    return "_".join([next((each.name for each in known if each.name.casefold() == own.casefold()), own), *label])


def _within(shapes: Sequence[tuple[float, Values]], number: int, freedom: int, share: float) -> tuple[float, float]:
    """Return between what a value is with a probability `share`, whichever the shape."""
    from scipy.optimize import brentq  # imported late: it is slow, and only a found effect needs it

    weight, value, error = np.array([(w, *values[number]) for w, values in shapes if number in values]).T
    tail = 0.5 - 0.5 * share
    far = 1.01 * float(stdtrit(freedom, 1.0 - tail)) * error

    def beyond(x: float, below: float) -> float:
        return float(weight @ stdtr(freedom, (x - value) / error) / weight.sum()) - below

    low, high = (brentq(beyond, np.min(value - far), np.max(value + far), args=(each,)) for each in (tail, 1.0 - tail))
    return low, high


def _place(candidate: Candidate, number: int) -> tuple[int, str]:
    """Which power of temperature, or which setpoint, a column's value belongs to."""
    if candidate.form == "constant":
        return 0, ""
    repeats = POWERS.get(candidate.form, len(candidate.stations_degC))
    part = number // (len(candidate.parameters) // repeats)
    if candidate.form == "table":
        return 0, f"{candidate.stations_degC[part]:z.1f} degC"
    return part, f"about {candidate.reference_degC:g} degC"


def _range(conditions: Conditions, acts: BoolArray) -> str:
    """Return the temperatures of the collects in which something acts, (n,)."""
    temperature = conditions.columns.get("temperature_degC", np.full(len(conditions), np.nan))[acts]
    if not np.any(np.isfinite(temperature)):
        return "the campaign's temperature (not recorded)"
    low, high = float(np.nanmin(temperature)), float(np.nanmax(temperature))
    return f"{low:z.1f} degC" if high - low < 1.0 else f"{low:z.1f} to {high:z.1f} degC"


def improved(
    model: Model,
    sensors: Mapping[int, SensorProblem],
    terms: Sequence[tuple[Candidate, Values]],
    scatter: Sequence[FoundScatter],
    record: Mapping[str, Mapping[str, Any]],
    calibrated: frozenset[int],
) -> Model:
    """Return the model with the added terms and scatter; a built-in gets the base values that belong to them.

    `record` says where each name came from. The base of sensors in `calibrated` has values at each temperature.
    """
    added: list[Term] = []
    for candidate, values in terms:
        name = "empirical" if candidate.effect is None else candidate.name
        known = {"sensor": candidate.sensor, "added": dict(record[name])}
        if candidate.effect is None:
            added += _empirical_terms(candidate, values, sensors[candidate.sensor].collects.conditions, known)
            continue
        curves, shape = _curves(candidate, values), dict(candidate.shape)
        added.append(Term(effect=candidate.effect.id, parameters=curves, shape=shape, **known))
    base = {number: base_curves(sensor, terms, number in calibrated) for number, sensor in sensors.items()}
    comparable = all(sensor.form.name in {model.form, "matrix-6"} for sensor in sensors.values())
    noise = dict(model.noise)
    for found in scatter:
        present = noise.get(found.sensor, SensorNoise())
        entry = ScatterTerm(
            effect=found.effect.id,
            parameters={found.parameter.name: Constant(unit=found.parameter.unit, value=found.value, se=found.se)},
            shape=dict(found.shape),
            channels=found.some,
            added=dict(record[found.effect.id]),
        )
        noise[found.sensor] = present.model_copy(update={"scatter": (*present.scatter, entry)})
    changes: dict[str, Any] = {"terms": (*model.terms, *added), "noise": noise}
    if comparable:
        changes["form"] = "matrix-6" if calibrated and model.form == "matrix-6-thermal" else model.form
        changes["sensors"] = {**model.sensors, **base}
    return model.model_copy(update=changes)


def left_by(
    sensor: SensorProblem, terms: Sequence[tuple[Candidate, Values]]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the base's columns (n, c, p), what all terms leave of the rates, and what they make, (n, c) each."""
    collects, made = sensor.collects, sensor.stated.copy()
    for candidate, values in (each for each in terms if each[0].sensor == sensor.number):
        for column, (value, _) in values.items():
            made += candidate.columns[:, :, column] * value
    return sensor.form.columns(collects.conditions), collects.rates_deg_per_hr - sensor.known_rates() - made, made


def base_curves(
    sensor: SensorProblem, terms: Sequence[tuple[Candidate, Values]], calibrated: bool
) -> Mapping[str, Curve]:
    """Fit the base to what the terms leave: one set of values, a set at each temperature, or a correction."""
    form = sensor.form
    columns, rates, _ = left_by(sensor, terms)
    fit = fit_to(rates, columns, sensor.collects.rates_se_deg_per_hr)
    if sensor.given is not None:
        return _shifted(sensor.given.sensors[sensor.number], form.names, fit)
    if calibrated:
        return _tables(sensor, columns, rates, fit)
    if form.reference_degC is None:
        return {n: Constant(unit=u, value=float(v)) for n, u, v in zip(form.names, form.units, fit, strict=True)}
    return {
        form.names[i]: Polynomial(
            unit=form.units[i], polynomial=tuple(float(v) for v in fit[i : i + 3]), reference_degC=form.reference_degC
        )
        for i in range(0, len(form.names), 3)
    }


def _tables(sensor: SensorProblem, columns: FloatArray, rates: FloatArray, whole: FloatArray) -> dict[str, Curve]:
    """Values at each temperature; what one temperature leaves open is as it is over the whole campaign."""
    conditions, form = sensor.collects.conditions, sensor.form
    numbers, temperature = same_temperature(conditions), conditions.columns["temperature_degC"]
    stations = [k for k in range(numbers.max() + 1) if np.any(numbers == k)]
    centres = [float(np.nanmean(temperature[numbers == k])) for k in stations]
    powers = 1 if form.reference_degC is None else 3
    own = []
    for k, centre in zip(stations, centres, strict=True):
        here = numbers == k
        left = rates[here] - columns[here] @ whole
        law = whole + fit_to(left, columns[here], sensor.collects.rates_se_deg_per_hr[here])
        own.append(law.reshape(-1, powers) @ (centre - (form.reference_degC or 0.0)) ** np.arange(powers))
    return {
        name: Table(unit=unit, table=TableRows(temperature_degC=tuple(centres), value=tuple(float(v[i]) for v in own)))
        for i, (name, unit) in enumerate(zip(form.names[::powers], form.units[::powers], strict=True))
    }


def _shifted(given: Mapping[str, Curve], names: Sequence[str], values: FloatArray) -> dict[str, Curve]:
    """Return the curves that stood, each with its fitted correction."""
    out: dict[str, Curve] = {}
    for name, correction in zip(names, values, strict=True):
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


def _curves(candidate: Candidate, found: Values) -> dict[str, Curve]:
    """Return one curve per parameter, in the candidate's form."""
    if candidate.form == "constant":
        return {
            candidate.parameters[k].name: Constant(unit=candidate.parameters[k].unit, value=value, se=error)
            for k, (value, error) in found.items()
        }
    repeats = POWERS.get(candidate.form, len(candidate.stations_degC))
    own = len(candidate.parameters) // repeats
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
    candidate: Candidate, found: Values, conditions: Conditions, known: Mapping[str, Any]
) -> list[Term]:
    """Return one term per channel and power: base parameter × driver, with the sign of the parameter's own column."""
    out = []
    for column, (value, error) in found.items():
        channel, power = _channel_and_power(candidate, column)
        driver = f"{candidate.driver}{power}"
        effect = EmpiricalTerm(candidate.changes[channel], driver)
        reference = driver_reference(driver, conditions)
        own = effect.columns(conditions, None, {"reference": reference})[:, channel, 0]
        mine = candidate.columns[:, channel, column]
        scale = float(own @ mine) / max(float(own @ own), 1e-300)
        unit = effect.parameters_for(conditions)[0].unit
        parameter = Constant(unit=unit, value=value * scale, se=abs(error * scale))
        out.append(Term(effect=effect.id, parameters={"q": parameter}, shape={"reference": reference}, **known))
    return out


def _channel_and_power(candidate: Candidate, column: int) -> tuple[int, str]:
    """Return in which channel a column of the second tier acts, and of which power of the driver it is, "" or "^2"."""
    order = len(candidate.parameters) // len(candidate.changes)
    return column // order, f"^{column % order + 1}" * (order > 1)
