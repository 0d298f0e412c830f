"""The simulated devices of a bench: one chamber, the units that lie in its air, and the bytes of them all."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drivers.imu import ImuIdentity
from drivers.simulators.chambers.catalogue import CHAMBER_SIMULATORS, SimulatorOptions
from drivers.simulators.chambers.controller import SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.unit import IndexSettings, SimulatedImu
from hil.config.bench import Bench
from hil.config.unit import ASK
from hil.errors import InputError, worded
from hil.model import fitting
from hil.twin.motion import FROM_THE_START, Resumed
from hil.twin.sensor import simulation_of
from hil.twin.unit import SimulatedUnit


@dataclass(frozen=True)
class SimulatedBench:
    """The chamber's device and every unit's, by the unit's name, and what they share.

    Tests look into `unit` for the truth and inject faults into the devices.
    """

    imus: Mapping[str, SimulatedImu]
    chamber: SimulatedController
    units: Mapping[str, SimulatedUnit]
    plant: ChamberPlant

    @property
    def imu(self) -> SimulatedImu:
        """The stream of the first unit, or the only one."""
        return next(iter(self.imus.values()))

    @property
    def unit(self) -> SimulatedUnit:
        """The first unit, or the only one."""
        return next(iter(self.units.values()))


def simulate_devices(bench: Bench, *, begins_s: float, resumed: Resumed = FROM_THE_START) -> SimulatedBench:
    """Return the devices that the bench's simulation section describes, at rest at `begins_s` on the caller's clock.

    The chamber begins at the start temperature, whatever it held before: a chamber cools (or warms) while nobody
    controls it. Raises `InputError` where the section, the model and the description do not go together.
    """
    settings = simulation_of(bench)
    plant = ChamberPlant(
        ambient_degC=settings.start.temperature,
        heating_degC_per_min=settings.chamber.heating,
        cooling_degC_per_min=settings.chamber.cooling,
        response_s=settings.chamber.response,
        settling_s=settings.chamber.settling,
        ripple_degC=settings.chamber.ripple,
        leak_s=settings.chamber.leak,
        begins_s=begins_s,
    )
    imus, units = dict[str, SimulatedImu](), dict[str, SimulatedUnit]()
    for name, own in bench.each.items():
        alike = next((units[other] for other in units if _kind(bench.each[other]) == _kind(own)), None)
        units[name] = _unit(own, plant, begins_s=begins_s, resumed=resumed, alike=alike)
        imus[name] = _imu(own, units[name], begins_s)
    options = SimulatorOptions(
        description=bench.chamber_description,
        **bench.chamber.spoken,
        faults=settings.chamber_faults,
        begins_s=begins_s,
    )
    with worded(InputError, f"{bench.source or bench.name}: the simulated chamber: "):
        chamber = CHAMBER_SIMULATORS[bench.chamber.driver](plant, options)
    return SimulatedBench(imus, chamber, units, plant)


def _kind(bench: Bench) -> tuple[object, ...]:
    """Return what a unit is like, all but what is its own: its name, its port, its noise and its faults."""
    own = {"seed": 0, "imu_faults": ()}
    simulation = bench.simulation and bench.simulation.model_copy(update=own)
    return simulation, bench.sensors, bench.imu.model_copy(update={"port": ""}), bench.imu_description, bench.positions


def _unit(bench: Bench, plant: ChamberPlant, **night: Any) -> SimulatedUnit:
    """Return the physics of one unit in the chamber's air."""
    roles = bench.frames.roles
    if roles is None or not set(bench.sensors) <= set(roles.sensors):
        raise InputError(
            f"{bench.source or bench.name}: imu.description: {bench.imu.description} does not say which fields are the "
            f"rates of sensor {', '.join(map(str, bench.sensors))}"
        )
    path = bench.simulation_model or ""
    model = fitting(path, [bench.sensor(number) for number in bench.sensors])
    for number in set(bench.sensors) - set(model.sensors):
        raise InputError(f"{path}: sensors.{number}: missing: a simulated unit needs values of its {model.form}")
    return SimulatedUnit(bench, model, roles, plant, sample_rate_hz=bench.frames.sample_rate_hz, **night)


def _imu(bench: Bench, unit: SimulatedUnit, begins_s: float) -> SimulatedImu:
    """Return the bytes of one unit; raise `InputError` where the frame that says who it is has no room for that."""
    settings, frames = simulation_of(bench), bench.frames
    identity = ImuIdentity(bench.unit.model, "SIM-0001" if bench.unit.serial == ASK else bench.unit.serial, "simulated")
    role = frames.roles.identity if frames.roles else None
    fields = frames.frames[role.frame].fields if role and role.frame else {}
    for key in ("model", "serial"):
        text, field = getattr(identity, key), fields.get(getattr(role, key, None) or "")
        if field is not None and not (text.isascii() and len(text) <= field.width):
            raise InputError(
                f"{bench.source or bench.name}: unit.{key}: {text!r}: a simulated unit says it in a frame of "
                f"{frames.name} that has room for {field.width} characters of ASCII; give a shorter one"
            )
    return SimulatedImu(
        frames,
        unit,
        identity=identity,
        index=IndexSettings(bench.position_codes, settings.start.position, settings.index_time),
        faults=settings.imu_faults,
        starts_s=begins_s,
        seed=settings.seed,
    )
