"""The second tier: every base parameter times every driver that the campaign knows, and curves over them.

Without it, something that is not in the catalogue would get the catalogue's nearest name.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.campaign.plausibility import accelerometer_columns
from hil.model.effects.base import Parameter
from hil.model.effects.followed import driver_values, expressible, position_is
from hil.model.forms import RATE
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.spoiled import MANY
from hil.solve.temperatures import same_temperature

_SLOPE = "dTdt_degC_per_min"
_FEWEST_VALUES = 6
_CURVE_ORDER = 3


@dataclass(frozen=True)
class Driver:
    """Something that a coefficient might follow: a name for people and its value at each row, shape (n,)."""

    name: str
    values: FloatArray
    kind: str


def drivers(conditions: Conditions) -> list[Driver]:
    """Return everything the campaign knows that a coefficient might follow, named by its expression.

    Conditions as they were measured (but accelerations, which show the pose), temperature and time as powers, setpoints
    and zones one by one, and steps from one run to the next.
    """
    expressions: list[tuple[str, str]] = []
    temperature = conditions.columns.get("temperature_degC")
    known = {"n_samples", *accelerometer_columns(conditions.sensor)}
    for name, values in conditions.columns.items():
        varies = np.all(np.isfinite(values)) and np.ptp(values) > 1e-9 * max(1.0, float(np.abs(values).max()))
        a_temperature = name in {"setpoint_degC", "chamber_degC", "case_degC"} and temperature is not None
        if varies and not a_temperature and name not in known and expressible(name):
            expressions.append((name, "condition"))
    if temperature is not None and np.all(np.isfinite(temperature)) and np.ptp(temperature) > 8.0:
        expressions += [(f"temperature_degC^{power}", "condition") for power in (2, 3, 4)]
        numbers = same_temperature(conditions)
        low = [float(temperature[numbers == k].min()) for k in range(numbers.max() + 1)]
        high = [float(temperature[numbers == k].max()) for k in range(numbers.max() + 1)]
        if len(low) > 2:
            expressions += [
                (f"temperature_degC[{a - 1:.1f}..{b + 1:.1f}]", "setpoint") for a, b in zip(low, high, strict=True)
            ]
            expressions += [
                (f"temperature_degC>{0.5 * (a + b):.1f}", "zone") for a, b in zip(low[1:], high, strict=False)
            ]
    if any(name == _SLOPE for name, _ in expressions):
        expressions.append((f"{_SLOPE}^2", "condition"))
    expressions += [("start_s", "time"), ("start_s^2", "time")]
    runs = list(dict.fromkeys(conditions.run.tolist()))
    if len(runs) > 5:
        expressions += [(f"run>{run}", "step") for run in runs[1 : -2 : 1 + len(runs) // MANY]]
    return [Driver(text, driver_values(text, conditions), kind) for text, kind in expressions]


def position_drivers(conditions: Conditions) -> list[Driver]:
    """Return one indicator per position that is visited more than once."""
    labels, counts = np.unique(conditions.position, return_counts=True)
    if len(labels) > 12:
        return []
    texts = [position_is(str(label)) for label, count in zip(labels, counts, strict=True) if count > 1]
    return [Driver(text, driver_values(text, conditions), "position") for text in texts]


def second_tier(number: int, conditions: Conditions) -> Iterator[Candidate]:
    """Yield parameter × driver terms: one column per channel, each with an amplitude of its own."""
    plain = drivers(conditions)
    zones = [driver for driver in plain if driver.kind == "zone"]
    for target, unit, values in _targets(conditions):
        for driver in plain:
            if target != "earth rate" or driver.kind == "condition":
                yield _term(number, conditions, target, unit, driver.name, values * driver.values[:, None])
        if target != "earth rate":
            for power_name, curve in _smooth(conditions):
                yield _curve(number, conditions, target, unit, power_name, values[:, :, None] * curve[:, None, :])
        if target == "B":
            for driver in plain:
                if _bears_a_curve(driver):
                    curve = _powers(driver.name, conditions, _CURVE_ORDER)
                    yield _curve(number, conditions, target, unit, driver.name, values[:, :, None] * curve[:, None, :])
    for place in position_drivers(conditions):
        both = [place.name]
        for zone in zones:
            both += [f"{place.name}&{zone.name}", f"{place.name}&{zone.name.replace('>', '<')}"]
        for text in both:
            yield _term(number, conditions, "B", RATE, text, driver_values(text, conditions)[:, None])


def _targets(conditions: Conditions) -> Iterator[tuple[str, str, FloatArray]]:
    """Yield what a driver may act on: name, unit and column per channel, shape (n, c) or (n, 1)."""
    sensor = conditions.sensor
    yield "B", RATE, np.ones((len(conditions), 1))
    for k, axis in enumerate(sensor.axes):
        if np.std(conditions.f_g[:, k]) > 0.05:
            name = {0: "GS", 2: "MU"}.get(k, f"g along {axis}") if sensor.is_rotor else f"g along {axis}"
            yield name, "deg/hr/g", conditions.f_g[:, k : k + 1]
    if np.any(conditions.w_deg_per_hr):
        yield "earth rate", "1", conditions.w_channels_deg_per_hr


def _smooth(conditions: Conditions) -> Iterator[tuple[str, FloatArray]]:
    """Yield smooth curves over temperature and time: powers one to five, shape (n, 5)."""
    temperature = conditions.columns.get("temperature_degC")
    known = temperature is not None and np.all(np.isfinite(temperature))
    if known and len(np.unique(same_temperature(conditions))) > 5:
        yield "temperature_degC", _powers("temperature_degC", conditions)
    if len(np.unique(conditions.run)) > 7:
        yield "start_s", _powers("start_s", conditions)


def _bears_a_curve(driver: Driver) -> bool:
    """Whether a recorded condition, temperature and time apart, takes enough values for a curve over it."""
    recorded = driver.kind == "condition" and "^" not in driver.name and driver.name != "temperature_degC"
    return recorded and len(np.unique(np.round(driver.values, 9))) >= _FEWEST_VALUES


def _powers(name: str, conditions: Conditions, order: int = 5) -> FloatArray:
    return np.stack([driver_values(f"{name}^{power}", conditions) for power in range(1, order + 1)], axis=1)


def _term(number: int, conditions: Conditions, target: str, unit: str, driver: str, values: FloatArray) -> Candidate:
    """One column per channel: `values`, shape (n, c) or (n, 1), in that channel only."""
    title = f"{target} follows {driver}"
    return _candidate(number, conditions, (target, driver, driver), title, unit, values[:, :, None])


def _curve(number: int, conditions: Conditions, target: str, unit: str, over: str, values: FloatArray) -> Candidate:
    """A smooth curve of no stated form: `values` (n, c or 1, k), each channel with amplitudes of its own."""
    title = f"{target} follows {over} in a way that no effect of the catalogue describes"
    return _candidate(number, conditions, (target, over, f"curve over {over}"), title, unit, values)


def _candidate(
    number: int, conditions: Conditions, of: tuple[str, str, str], title: str, unit: str, values: FloatArray
) -> Candidate:
    """Values (n, c or 1, k), in one channel only for each: `of` a target, what drives it, and how."""
    (target, driver, how), channels, order = of, len(conditions.sensor.channels), values.shape[2]
    each = np.broadcast_to(values, (len(conditions), channels, order))[:, :, None, :] * np.eye(channels)[:, :, None]
    return Candidate(
        name=f"{target} × {how}",
        tier=2,
        sensor=number,
        columns=each.reshape(len(conditions), channels, channels * order),
        parameters=_amplitudes(conditions, unit, order),
        title=title,
        equation=f"rate += amplitude × {target} × {how}",
        driver=driver,
        target=target,
    )


def _amplitudes(conditions: Conditions, unit: str, order: int) -> tuple[Parameter, ...]:
    suffixes = [""] if order == 1 else [f"_{k}" for k in range(1, order + 1)]
    return tuple(
        Parameter(f"amplitude_{axis}{suffix}", unit, (0.0, np.inf))
        for axis in conditions.sensor.channels.values()
        for suffix in suffixes
    )
