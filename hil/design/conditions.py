"""The conditions that a planned sweep will have, before a night is spent: one row per collect and sensor.

    conditions = planned_conditions(make_plan(sweep.procedure()), bench)[2]

Temperatures follow the plan's setpoints through the usual two lags and self-heating, so that what changes while a unit
restabilises is there to be seen, as far as the unit shows it. Supply and spin are not planned, so they are no columns.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from hil.campaign import Conditions, FloatArray
from hil.campaign.stand_ins import OWN, told
from hil.config.bench import Bench
from procedures.plan import Plan, Step, StepKind

CASE_LAG_S, ROTOR_LAG_S = 12 * 60.0, 10 * 60.0
SELF_HEATING_DEGC, SELF_HEATING_LAG_S = 8.0, 15 * 60.0
"""What is usual for such a unit; a plan only needs their order of size."""

_GRID_S = 10.0


def planned_conditions(plan: Plan, bench: Bench) -> dict[int, Conditions]:
    """Return the conditions of every planned collect, by sensor of the bench."""
    steps = [step for step in plan.steps if step.kind is StepKind.COLLECT]
    settle_s = np.array([step.parameters.get("settle_s", 0.0) for step in steps])
    duration_s = np.array([step.parameters.get("duration_s", step.duration_s) for step in steps])
    start_s = np.array([step.starts_s for step in steps]) + settle_s
    columns = _columns(plan, start_s, start_s + 0.5 * duration_s)
    columns |= {"time_since_power_on_s": start_s, "time_since_index_s": settle_s}
    position = np.array([str(step.position) for step in steps])
    every = {
        number: Conditions(
            bench.sensor(number),
            collect=np.arange(1, len(steps) + 1),
            run=np.array([step.self_calibration for step in steps], dtype=np.int64),
            position=position,
            start_s=start_s,
            duration_s=duration_s,
            **bench.along_axes(number, position),
            columns=_of_the_stream(columns, bench, number),
        )
        for number in bench.sensors
    }
    return {number: replace(rows, columns={OWN: told(rows)[1], **rows.columns}) for number, rows in every.items()}


def _of_the_stream(columns: Mapping[str, FloatArray], bench: Bench, number: int) -> dict[str, FloatArray]:
    """Leave out what the unit's stream does not have."""
    if (roles := bench.frames.roles) is None:
        return dict(columns)
    own = roles.sensors.get(number)
    lacking = set() if own and own.temperature else {OWN, "dTdt_degC_per_min"}
    lacking |= {"case_degC"} - {*roles.conditions, *(own.conditions if own else ())}
    return {name: of for name, of in columns.items() if name not in lacking}


def _columns(plan: Plan, start_s: FloatArray, middle: FloatArray) -> dict[str, FloatArray]:
    setpoints = [step for step in plan.steps if step.kind is StepKind.SETPOINT]
    times, air, case, rotor = _temperatures(plan, setpoints)
    commanded = np.array([step.starts_s for step in setpoints])
    latest = np.searchsorted(commanded, start_s, side="right") - 1
    return {
        "temperature_degC": np.interp(middle, times, rotor),
        "dTdt_degC_per_min": 60.0 * np.interp(middle, times, np.gradient(rotor, _GRID_S)),
        "case_degC": np.interp(middle, times, case),
        "chamber_degC": np.interp(middle, times, air),
        "setpoint_degC": np.array([setpoints[index].temperature_degC for index in latest], dtype=np.float64),
        "time_since_setpoint_s": start_s - commanded[latest],
    }


def _temperatures(plan: Plan, setpoints: list[Step]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a time grid with air, case and rotor temperature: ramps at the planned rate, then two first-order lags."""
    times = np.arange(0.0, plan.total_s + _GRID_S, _GRID_S)
    first = setpoints[0]
    target = float(first.temperature_degC or 0.0)
    change = first.duration_s / 60.0 * first.parameters.get("ramp_degC_per_min", 0.0)
    # The first ramp begins where its duration and rate say.
    knots_s, knots_degC = [0.0], [target - change if target > 23.0 else target + change]
    for step in setpoints:
        knots_s += [step.starts_s, step.starts_s + step.duration_s]
        knots_degC += [knots_degC[-1], float(step.temperature_degC or 0.0)]
    air = np.interp(times, knots_s, knots_degC)
    case = _lagged(air, CASE_LAG_S)
    # As the twin has it: warmed through, the unit reads the setpoint, at which its parameters are known.
    lacking = SELF_HEATING_DEGC * np.exp(-times / SELF_HEATING_LAG_S)
    return times, air, case, _lagged(case, ROTOR_LAG_S) - lacking


def _lagged(values: FloatArray, lag_s: float) -> FloatArray:
    weight = -np.expm1(-_GRID_S / lag_s)
    start = np.array([(1.0 - weight) * values[0]])
    return np.asarray(lfilter([weight], [1.0, weight - 1.0], values, zi=start)[0])
