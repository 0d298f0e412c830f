"""The simulation section of a bench file: what the simulated unit and chamber are like."""

from typing import Annotated

from pydantic import BeforeValidator, Field, NonNegativeInt

from drivers.simulators.chambers.controller import ChamberFault
from drivers.simulators.unit import FaultWindow
from hil.config.sections import settings_of
from hil.files.strict import Section
from hil.files.units import (
    Celsius,
    CelsiusDifference,
    CelsiusPerMinute,
    DegreesPerHour,
    Gravities,
    RandomWalk,
    Seconds,
    Volts,
)

PositiveSeconds = Annotated[Seconds, Field(gt=0.0)]


class StartSection(Section):
    """How the simulated night begins: everything at one temperature, the unit just switched on."""

    temperature: Celsius = 23.0
    position: Annotated[str, BeforeValidator(str)] = "3"
    powered_for: Seconds = 0.0


class ThermalSection(Section):
    """Two lags in cascade from the chamber's air to the rotors, and the rotors' own heat after spin-on."""

    case_lag: PositiveSeconds = 720.0
    rotor_lag: PositiveSeconds = 600.0
    self_heating: CelsiusDifference = 8.0
    self_heating_lag: PositiveSeconds = 900.0


class NoiseSection(Section):
    """What scatters. The sensors' own noise and run-to-run scatter stand in the model file; this is the rest.

    `angle_random_walk` is for sensors to which the model file gives no noise. `slow` adds the model's bias instability
    and rate random walk, which the standard error of a single collect cannot know. Both wander from grid point to grid
    point, bias instability with time constants from 10 s on: averages of less time lack what those of a real sensor
    have, and `hil allan` says of such a record that its terms do not describe it.
    """

    angle_random_walk: RandomWalk = 0.12
    slow: bool = False
    run_to_run: bool = True
    new_run_after_rest: Seconds = 600.0
    accelerometers: Annotated[Gravities, Field(ge=0.0)] = 20e-6
    thermometers: CelsiusDifference = 0.01
    supply: Volts = 0.002
    supply_wander: Volts = 0.02


class SettlingSection(Section):
    """The rates' decaying error after an index move, slower when cold."""

    size: DegreesPerHour = 30.0
    time_constant: PositiveSeconds = 5.0
    time_constant_cold: PositiveSeconds = 10.0


class SimulatedChamberSection(Section):
    """How fast the simulated chamber's air moves, how its own controller settles, and what it leaks to when off."""

    heating: Annotated[CelsiusPerMinute, Field(gt=0.0)] = 3.0
    cooling: Annotated[CelsiusPerMinute, Field(gt=0.0)] = 3.0
    response: PositiveSeconds = 20.0
    settling: PositiveSeconds = 60.0
    ripple: CelsiusDifference = 0.05
    leak: PositiveSeconds = 3600.0


class SimulationSection(Section):
    """What is simulated. The seed makes a night reproducible to the byte; it is in the record."""

    seed: NonNegativeInt
    model: str
    start: StartSection = StartSection()
    thermal: ThermalSection = ThermalSection()
    noise: NoiseSection = NoiseSection()
    settling: SettlingSection = SettlingSection()
    supply: Volts = 28.0
    index_time: PositiveSeconds = 5.0
    chamber: SimulatedChamberSection = SimulatedChamberSection()
    imu_faults: tuple[Annotated[FaultWindow, settings_of(FaultWindow)], ...] = ()
    chamber_faults: tuple[Annotated[ChamberFault, settings_of(ChamberFault)], ...] = ()
