"""The conditions that a planned sweep will have, before a night is spent: one row per collect and sensor.

    conditions = planned_conditions(make_plan(sweep.procedure()), bench)[2]

Temperatures follow the plan's setpoints through the two lags and the self-heating that are usual of a simulated unit,
so that what changes while a unit restabilises is there to be seen, as far as the unit shows it. Supply and spin are not
planned, so they are no columns.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.campaign.stand_ins import OWN, told
from hil.config.bench import Bench
from hil.config.simulation import ThermalSection
from hil.twin.thermal import GRID_S, ThermalUnit
from procedures.plan import Plan, StepKind


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
    if (roles := bench.frames.roles) is None:
        return dict(columns)
    own = roles.sensors.get(number)
    lacking = set() if own and own.temperature else {OWN, "dTdt_degC_per_min"}
    lacking |= {"case_degC"} - {*roles.conditions, *(own.conditions if own else ())}
    return {name: of for name, of in columns.items() if name not in lacking}


def _columns(plan: Plan, start_s: FloatArray, middle_s: FloatArray) -> dict[str, FloatArray]:
    setpoints = [step for step in plan.steps if step.kind is StepKind.SETPOINT]
    # The chamber's air goes from setpoint to setpoint at the planned rate; the first ramp begins where its rate says.
    first, target = setpoints[0], float(setpoints[0].temperature_degC or 0.0)
    change = first.duration_s / 60.0 * first.parameters.get("ramp_degC_per_min", 0.0)
    turns_s, air_degC = [0.0], [target - change if target > 23.0 else target + change]
    for step in setpoints:
        turns_s += [step.starts_s, step.starts_s + step.duration_s]
        air_degC += [air_degC[-1], float(step.temperature_degC or 0.0)]
    planned = {"start_degC": air_degC[0], "begins_s": 0.0, "powered_for_s": 0.0}
    thermal = ThermalUnit(ThermalSection(), lambda at_s: np.interp(at_s, turns_s, air_degC), **planned)
    times_s, degC, slopes = thermal.advance(plan.total_s + GRID_S)
    commanded = np.array([step.starts_s for step in setpoints])
    latest = np.searchsorted(commanded, start_s, side="right") - 1
    return {
        "temperature_degC": np.interp(middle_s, times_s, degC[:, 2]),
        "dTdt_degC_per_min": 60.0 * np.interp(middle_s, times_s, slopes[:, 1]),
        "case_degC": np.interp(middle_s, times_s, degC[:, 1]),
        "chamber_degC": np.interp(middle_s, times_s, degC[:, 0]),
        "setpoint_degC": np.array([setpoints[index].temperature_degC for index in latest], dtype=np.float64),
        "time_since_setpoint_s": start_s - commanded[latest],
    }
