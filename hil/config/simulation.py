"""What the simulated unit and chamber of a bench file are like, and what goes wrong with them, and when.

    faults:
      - {at: 2 h, device: imu, kind: silence, duration: 10 min}
      - {at: T1/S1/restabilise, device: chamber, kind: alarm}     # as the step begins
      - {at: 95 min, device: imu, kind: corrupted_bytes, size: 0.2, duration: 5 min}

`CATALOGUE` says what there is. `hil.twin.devices` makes it happen.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, NonNegativeInt

from drivers.simulators.chambers.controller import ChamberFault
from drivers.simulators.unit import FaultWindow
from drivers.strict_yaml import packaged
from hil.config.sections import settings_of
from hil.files import units
from hil.files.strict import Section, near

PositiveSeconds = Annotated[units.Seconds, Field(gt=0.0)]


class StartSection(Section):
    """How the simulated night begins: everything at one temperature, the unit just switched on."""

    temperature: units.Celsius = 23.0
    position: Annotated[str, BeforeValidator(str)] = "3"
    powered_for: units.Seconds = 0.0


class ThermalSection(Section):
    """Two lags in cascade from the chamber's air to the rotors, and the rotors' own heat after spin-on."""

    case_lag: PositiveSeconds = 720.0
    rotor_lag: PositiveSeconds = 600.0
    self_heating: units.CelsiusDifference = 8.0
    self_heating_lag: PositiveSeconds = 900.0


class NoiseSection(Section):
    """What scatters. The sensors' own noise and run-to-run scatter stand in the model file; this is the rest.

    `angle_random_walk` is for sensors to which the model file gives no noise. `slow` adds the model's bias instability
    and rate random walk, which the standard error of a single collect cannot know. Both wander from grid point to grid
    point, bias instability with time constants from 10 s on: averages of less time lack what those of a real sensor
    have, and `hil allan` says of such a record that its terms do not describe it.
    """

    angle_random_walk: units.RandomWalk = 0.12
    slow: bool = False
    run_to_run: bool = True
    new_run_after_rest: units.Seconds = 600.0
    accelerometers: Annotated[units.Gravities, Field(ge=0.0)] = 20e-6
    thermometers: units.CelsiusDifference = 0.01
    supply: units.Volts = 0.002
    supply_wander: units.Volts = 0.02


class SettlingSection(Section):
    """The rates' decaying error after an index move, slower when cold."""

    size: units.DegreesPerHour = 30.0
    time_constant: PositiveSeconds = 5.0
    time_constant_cold: PositiveSeconds = 10.0


class SimulatedChamberSection(Section):
    """How fast the simulated chamber's air moves, how its own controller settles, and what it leaks to when off."""

    heating: Annotated[units.CelsiusPerMinute, Field(gt=0.0)] = 3.0
    cooling: Annotated[units.CelsiusPerMinute, Field(gt=0.0)] = 3.0
    response: PositiveSeconds = 20.0
    settling: PositiveSeconds = 60.0
    ripple: units.CelsiusDifference = 0.05
    leak: PositiveSeconds = 3600.0


class SimulationSection(Section):
    """What is simulated. The seed makes a night reproducible to the byte; it is in the record."""

    seed: NonNegativeInt
    model: str
    start: StartSection = StartSection()
    thermal: ThermalSection = ThermalSection()
    noise: NoiseSection = NoiseSection()
    settling: SettlingSection = SettlingSection()
    supply: units.Volts = 28.0
    index_time: PositiveSeconds = 5.0
    chamber: SimulatedChamberSection = SimulatedChamberSection()
    imu_faults: tuple[Annotated[FaultWindow, settings_of(FaultWindow)], ...] = ()
    chamber_faults: tuple[Annotated[ChamberFault, settings_of(ChamberFault)], ...] = ()


Device = Literal["imu", "chamber", "disk", "clock", "operator", "controller"]

_JUMP = units.Kind("a time", "second", "-90 s")


def _text(value: object) -> object:
    """A number without its unit is said to be one by `to_number`."""
    return str(value) if isinstance(value, int | float) else value


@dataclass(frozen=True)
class FaultKind:
    """One thing that can go wrong: what it is in words and to a simulator, and what its size is and `sets` there.

    `size` is a kind of quantity, or "share" for a fraction of the frames; None where it has none, and then `usual` is
    meaningless. `lasts` is True for a state, which has a duration, and False for something that happens in a moment.
    """

    means: str
    simulated: str
    size: units.Kind | Literal["share"] | None = None
    sets: str = ""
    usual: float = 0.0
    lasts: bool = True


_SIZES = {"time": units.TIME, "jump": _JUMP, "temperature": units.TEMPERATURE, "difference": units.DIFFERENCE}
CATALOGUE: Mapping[Device, Mapping[str, FaultKind]] = {
    device: {
        kind: FaultKind(**{"simulated": kind} | said | {"size": _SIZES.get(said.get("size"), said.get("size"))})
        for kind, said in of.items()
    }
    for device, of in packaged("hil.config", "faults.yaml").items()
}


class Fault(Section):
    """One fault. `at` is a time since the night began, or the key of a step as `hil plan --json` shows it.

    `unit` is the serial number of the unit that it happens to; of several it happens to all where none is said.
    """

    at: Annotated[str, BeforeValidator(_text)]
    device: Device
    kind: str
    size: float | str | None = None
    duration: Annotated[str | None, BeforeValidator(_text)] = None
    unit: Annotated[str, BeforeValidator(str)] = ""

    def _check(self) -> None:
        kinds = CATALOGUE[self.device]
        if self.kind not in kinds:
            raise ValueError(f"kind: {self.kind!r} is nothing that happens to {self.device}{near(self.kind, [*kinds])}")
        if not self.at.strip():
            raise ValueError("at: a time such as 2 h, or a step's key such as T1/S1/restabilise, is needed")
        _ = self.at_s, self.amount
        if self.unit and self.device != "imu":
            raise ValueError(f"unit: what happens to {self.device} happens to no unit; leave it out")
        if self.duration is not None and not self.meaning.lasts:
            raise ValueError(f"duration: {self.kind} happens in a moment; leave the duration out")
        _ = self.duration_s

    @cached_property
    def amount(self) -> float:
        """The size in s, °C or as a share: the file's, or the usual one; `ValueError` where it cannot be."""
        kind = self.meaning
        if self.size is None:
            return kind.usual
        if kind.size is None:
            raise ValueError(f"size: {self.kind} has no size; leave it out")
        if not isinstance(kind.size, str):
            return units.to_number(self.size, kind.size)
        if isinstance(self.size, str) or not 0.0 < self.size <= 1.0:
            raise ValueError(f"size: {self.size!r} is not a share of the frames; write a number above 0 and up to 1")
        return float(self.size)

    @cached_property
    def at_s(self) -> float | None:
        """Seconds since the night began; None where it waits for the step `at`."""
        return units.to_number(self.at, units.TIME) if self.at[0] in "0123456789+-." else None

    @cached_property
    def duration_s(self) -> float | None:
        """How long it lasts, s; None for the rest of the night."""
        return None if self.duration is None else units.to_number(self.duration, units.TIME)

    @property
    def meaning(self) -> FaultKind:
        """What the catalogue says about it."""
        return CATALOGUE[self.device][self.kind]

    def __str__(self) -> str:
        size = "" if self.size is None else f" {self.size}"
        lasts = "" if self.duration is None else f" for {self.duration}"
        return f"{self.device}{f' {self.unit}' if self.unit else ''} {self.kind}{size} at {self.at}{lasts}"
