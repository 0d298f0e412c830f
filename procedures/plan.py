"""A sweep is a list of steps: pure data, made once from the sweep file.

One list is dry run, estimated finishing time, run, resume and proof of completeness: nothing else decides what is next.

    >>> plan = make_plan(SweepProcedure(title="At 40 °C", temperatures_degC=(40.0,), positions=("1", "2")))
    >>> [step.key for step in plan.steps][:5]
    ['identify', 'T1/setpoint', 'T1/S1/restabilise', 'T1/S1/C1/index', 'T1/S1/C1/collect']
    >>> plan.total_s
    9055.0
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from itertools import groupby
from typing import Any

from procedures.settings import SweepProcedure


class StepKind(StrEnum):
    """What a step does."""

    IDENTIFY = "identify"  # ask the devices who they are, refuse the wrong ones
    SETPOINT = "setpoint"  # command the chamber
    RESTABILISE = "restabilise"  # wait for evidence that the unit is in thermal equilibrium
    INDEX = "index"  # bring the unit to a collect position
    COLLECT = "collect"  # settle, sample, average
    SAFE_STATE = "safe_state"  # leave the chamber as it may be left


OF_UNITS = (StepKind.IDENTIFY, StepKind.INDEX, StepKind.COLLECT)
"""What is done to a unit: of several in one chamber each has its own step. All else is done to the chamber."""


@dataclass(frozen=True)
class Step:
    """One step; `key` is unique in a plan, stays the same for a sweep, and tells whose it is behind the @."""

    index: int
    key: str  # "T1/S2/restabilise", "T1/S2/C3/collect"
    kind: StepKind
    starts_s: float  # planned, from the beginning of the sweep
    duration_s: float  # planned
    temperature_degC: float | None = None
    self_calibration: int | None = None  # the campaign's `run`: 1, 2, … over the whole sweep
    position: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)  # seconds, °C and °C/min, named

    @property
    def stage(self) -> str:
        """The key without the unit: what is done at once."""
        return self.key.partition("@")[0]

    @property
    def unit(self) -> str | None:
        """The unit's name, empty for the one of a bench that lists none; None where the step is the chamber's."""
        return self.key.partition("@")[2] if self.kind in OF_UNITS else None

    def of(self, unit: str) -> "Step":
        """Return what is done to another unit in the same stage; what is done to the chamber is done to all."""
        return self if self.unit in (None, unit) else replace(self, key=_of_unit(self.stage, unit))


@dataclass(frozen=True)
class Plan:
    """The steps of one sweep, in order."""

    title: str
    steps: Sequence[Step]

    @property
    def total_s(self) -> float:
        """Planned duration of the whole sweep."""
        last = self.steps[-1]
        return last.starts_s + last.duration_s

    @cached_property
    def stages(self) -> Sequence[Sequence[Step]]:
        """The steps in order, those that are done at once together."""
        return [tuple(steps) for _, steps in groupby(self.steps, key=lambda step: step.stage)]

    @cached_property
    def units(self) -> Sequence[str]:
        """The names of the units, in order."""
        return list(dict.fromkeys(step.unit for step in self.steps if step.unit is not None))

    def of_unit(self, unit: str) -> "Plan":
        """Return what is done to one unit and to the chamber."""
        return Plan(self.title, tuple(step for step in self.steps if step.unit in (None, unit)))

    def of_kind(self, kind: StepKind) -> Sequence[Step]:
        """Return the steps of one kind, in order."""
        return [step for step in self.steps if step.kind is kind]

    @property
    def self_calibrations(self) -> Mapping[int, Sequence[Step]]:
        """The steps of each self-calibration, by its number in the sweep."""
        groups: dict[int, list[Step]] = {}
        for step in self.steps:
            if step.self_calibration is not None:
                groups.setdefault(step.self_calibration, []).append(step)
        return groups


_IDENTIFY_S = 10.0
_SAFE_STATE_S = 5.0


def make_plan(procedure: SweepProcedure, units: Sequence[str] = ("",)) -> Plan:
    """Return the steps of a sweep of these units with their expected times.

    Expected: ramps at the procedure's rate, soaks of the scheduled time, indexing and collects as set. A soak that
    needs more evidence, or a slower chamber, moves everything behind it.
    """
    steps, starts_s, air_degC, number = list[Step](), 0.0, procedure.start_degC, 0
    soak, collect, rate = procedure.restabilisation, procedure.collect, procedure.ramp_degC_per_min

    def add(key: str, kind: StepKind, duration_s: float, **more: Any) -> None:
        nonlocal starts_s
        for unit in units if kind in OF_UNITS else ("",):
            steps.append(Step(len(steps), _of_unit(key, unit), kind, starts_s, duration_s, **more))
        starts_s += duration_s

    def ramp(key: str, to_degC: float) -> None:
        nonlocal air_degC
        ramp_s = 60.0 * abs(to_degC - air_degC) / rate
        bounds = {"ramp_degC_per_min": rate, "band_degC": soak.band_degC}
        add(key, StepKind.SETPOINT, ramp_s, temperature_degC=to_degC, parameters=bounds)
        air_degC = to_degC

    add("identify", StepKind.IDENTIFY, _IDENTIFY_S)
    soak_s, collect_s = max(soak.at_least_s, soak.window_s), collect.settle_s + collect.duration_s
    soaking, collecting = soak.as_parameters(), collect.as_parameters()
    indexing = {"index_timeout_s": collect.index_timeout_s}
    for t, temperature_degC in enumerate(procedure.temperatures_degC, start=1):
        ramp(f"T{t}/setpoint", temperature_degC)
        for s in range(1, procedure.self_calibrations + 1):
            number += 1
            key, here = f"T{t}/S{s}", {"temperature_degC": temperature_degC, "self_calibration": number}
            add(f"{key}/restabilise", StepKind.RESTABILISE, soak_s, parameters=soaking, **here)
            for c, position in enumerate(procedure.positions, start=1):
                at = {**here, "position": position}
                add(f"{key}/C{c}/index", StepKind.INDEX, collect.index_s, parameters=indexing, **at)
                add(f"{key}/C{c}/collect", StepKind.COLLECT, collect_s, parameters=collecting, **at)
    if procedure.final_degC is not None:
        ramp("final/setpoint", procedure.final_degC)
    add("safe-state", StepKind.SAFE_STATE, _SAFE_STATE_S)
    return Plan(procedure.title, tuple(steps))


def lasting_s(steps: Iterable[Step]) -> float:
    """Return the planned duration of some steps of a plan: those of one stage are done at once."""
    return sum({step.stage: step.duration_s for step in steps}.values())


def _of_unit(stage: str, unit: str) -> str:
    return f"{stage}@{unit}" if unit else stage
