"""The sweep file: which temperatures, how many self-calibrations at each, which collects, and when a soak is enough."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from hil.config.bench import Bench
from hil.config.limits import Limits, load_limits
from hil.config.sections import settings_of
from hil.errors import InputError, worded
from hil.files.strict import WholeFile, near
from hil.files.units import Celsius, CelsiusPerMinute
from hil.model import fitting
from procedures.plan import Plan, make_plan
from procedures.safe_air import ROOM_DEGC
from procedures.settings import CollectSettings, Restabilisation, SweepProcedure
from procedures.words import counted

PUBLISHED = "rd-gc-86-1"
"""The vocabulary of the published report: the contractor's solution beside the matrix, its tables, its equations."""

# YAML reads an unquoted 1 as a number; a position's label is text.
_Label = Annotated[str, BeforeValidator(str)]
_MOST_COLLECTS = 100_000
MOST_OF_ONE = 1000
LONGEST_DAYS = 60


class Sweep(WholeFile):
    """A sweep, as its file describes it."""

    folder = "sweeps"
    title: str
    temperatures: tuple[Celsius, ...] = Field(min_length=1)
    self_calibrations_per_temperature: int = Field(default=3, ge=1, le=MOST_OF_ONE, strict=True)
    positions: Annotated[tuple[_Label, ...], Field(min_length=1)] = ("1", "2", "3")
    restabilisation: Annotated[Restabilisation, settings_of(Restabilisation)] = Restabilisation()
    collect: Annotated[CollectSettings, settings_of(CollectSettings)] = CollectSettings()
    ramp: Annotated[CelsiusPerMinute, Field(gt=0.0, le=100.0)] = 3.0
    start: Celsius = 23.0
    final: Celsius | None = None
    vocabulary: Literal["plain", "rd-gc-86-1"] = "plain"  # whose words the report speaks
    limits: str | None = None  # of the unit's parameters: a file

    def procedure(self) -> SweepProcedure:
        """Return the sweep as the procedures take it."""
        return SweepProcedure(
            title=self.title,
            temperatures_degC=self.temperatures,
            self_calibrations=self.self_calibrations_per_temperature,
            positions=self.positions,
            restabilisation=self.restabilisation,
            collect=self.collect,
            ramp_degC_per_min=self.ramp,
            start_degC=self.start,
            final_degC=self.final,
        )


parse_sweep, load_sweep = Sweep.parse, Sweep.load


def planned(sweep: Sweep, bench: Bench) -> Plan:
    """Return the steps of a sweep on a bench, for all of its units."""
    return make_plan(sweep.procedure(), list(bench.each))


def limits_of(sweep: Sweep | None, bench: Bench) -> Limits | None:
    """Return the limits that sweep, or else bench, names, None for none; `InputError` if they are not this unit's."""
    named = sweep if sweep is not None and sweep.limits is not None else bench
    if named.limits is None:
        return None
    with worded(InputError, f"{named.source}: limits: ", InputError):
        limits = load_limits(named.limits, Path(named.source).parent)
        for each in bench.each.values():
            limits.check({number: each.sensor(number) for number in each.sensors}, each.unit.model)
    return limits


def check_sweep_against_bench(sweep: Sweep, bench: Bench) -> None:
    """Raise `InputError` where the sweep asks for what cannot be: of the bench, of the equations, or in one life."""
    _refuse_endless(sweep)
    limits_of(sweep, bench)
    count = len(sweep.positions)
    for each in bench.each.values() if count > 1 and len(set(sweep.positions)) == 1 else ():
        for rotor in [number for number in each.sensors if each.sensor(number).is_rotor]:
            raise InputError(
                f"{sweep.source}: positions: {', '.join(sweep.positions)} is one position {count} times; one equation "
                f"written {count} times solves nothing for sensor {rotor}; name other positions too, or this one once "
                "and a longer collect"
            )
    wanted = [(f"temperatures.{index}", value) for index, value in enumerate(sweep.temperatures)]
    wanted += [("final", sweep.final)] if sweep.final is not None else []
    for key, value in wanted:
        if outside := bench.outside(value):
            raise InputError(f"{sweep.source}: {key}: {outside}")
    for each in bench.each.values():
        if each.simulation is not None and each.simulation_model is not None:
            levels = each.simulation.start.temperature, *(value for _, value in wanted)
            fitting(each.simulation_model, [each.sensor(number) for number in each.sensors], levels)
    steps = planned(sweep, bench).steps
    keys = list(dict.fromkeys(name for step in steps for name in (step.key, step.stage)))
    for index, fault in enumerate(bench.faults):
        if fault.at_s is None and fault.at not in keys:
            raise InputError(
                f"{bench.source}: faults.{index}.at: {fault.at!r} is no step of {sweep.source}{near(fault.at, keys)}"
            )
    oriented = [of for each in bench.each.values() for of in each.sensors.items()]
    for label in sweep.positions:
        for number, section in oriented:
            if label not in section.built:
                raise InputError(
                    f"{sweep.source}: positions: bench {bench.name} gives no orientation of sensor {number} at "
                    f"position {label}; it knows {', '.join(section.built)}"
                )


def _refuse_endless(sweep: Sweep) -> None:
    runs = len(sweep.temperatures) * sweep.self_calibrations_per_temperature
    if runs * len(sweep.positions) > _MOST_COLLECTS:
        raise InputError(
            f"{sweep.source}: {counted(len(sweep.temperatures), 'temperature')}, "
            f"{sweep.self_calibrations_per_temperature} self_calibrations_per_temperature and "
            f"{counted(len(sweep.positions), 'position')} make more than {_MOST_COLLECTS} collects"
        )
    total_s = make_plan(sweep.procedure()).total_s
    if total_s > LONGEST_DAYS * 86400.0:
        raise InputError(
            f"{sweep.source}: it would take {total_s / 86400.0:.0f} days, more than {LONGEST_DAYS}; look at "
            "temperatures, self_calibrations_per_temperature, restabilisation.at_least and collect.duration"
        )


def cautions(sweep: Sweep, bench: Bench) -> list[str]:
    """Say what is allowed but deserves a second look: collects that cannot support every parameter, an end at 60 °C."""
    ending = [f"{sweep.source}: final: {each}" for each in [left_hot_or_cold(sweep, bench)] if each]
    different = list(dict.fromkeys(sweep.positions))
    rotors = [number for number in bench.sensors if bench.sensor(number).is_rotor]
    if len(different) >= 3 or not rotors:
        return ending
    count = counted(len(different), "different position")
    listed = f"{sweep.source}: positions: {', '.join(sweep.positions)}"
    return [f"{listed} is {count}; bias, GS and MU of a two-channel sensor need three", *ending]


def left_hot_or_cold(sweep: Sweep, bench: Bench) -> str:
    """Say that the night ends where nobody should open the chamber; empty where it does not."""
    last, safe = sweep.temperatures[-1], bench.chamber.safe_state
    if sweep.final is not None or safe.temperature_degC is not None or ROOM_DEGC[0] <= last <= ROOM_DEGC[1]:
        return ""
    return f"the night ends in {safe.words} with the chamber at {last:.1f} °C; better: final: 23 degC, in the sweep"
