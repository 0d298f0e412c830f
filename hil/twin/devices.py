"""The simulated devices of a bench: one chamber whose air the simulated unit lies in, and both controllers' bytes."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.frames.description import StreamDescription
from drivers.imu import ImuIdentity
from drivers.simulators import SimulatedDevice
from drivers.simulators.chambers.catalogue import (
    CHAMBER_SIMULATORS,
    SimulatedChamberController,
    SimulatorOptions,
    ramp_port_of,
)
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.unit import IndexSettings, SimulatedImu
from hil.config.bench import ASK, Bench
from hil.errors import InputError
from hil.model import load_model
from hil.twin.unit import SimulatedUnit


@dataclass(frozen=True)
class SimulatedBench:
    """Both devices and what they share. Tests ask `unit` for the truth and inject faults into the devices.

    `ramp` is the chamber's second port, where its controller takes its ramp on one.
    """

    imu: SimulatedImu
    chamber: SimulatedChamberController
    unit: SimulatedUnit
    plant: ChamberPlant
    ramp: SimulatedDevice | None = None

    @property
    def ramp_port(self) -> SimulatedDevice:
        """The chamber's second port; raise `ValueError` where it has none."""
        if self.ramp is None:
            raise ValueError("this chamber has no second port for its ramp")
        return self.ramp


def simulate_devices(
    bench: Bench,
    description: StreamDescription,
    *,
    begins_s: float,
    first_run: int = 1,
    visited: Sequence[str] = (),
    session: int = 0,
) -> SimulatedBench:
    """Return the devices that the bench's simulation section describes, at rest at `begins_s` on the caller's clock.

    The chamber begins at the start temperature, whatever it held before: a chamber cools (or warms) while nobody
    controls it. `first_run`, `visited` and `session` carry on a night: the number of the self-calibration that comes
    next or is half done, which keeps its run-to-run scatter; the positions whose collects it has; and a number that no
    earlier part of the night had, for new noise.
    Raises `InputError` where the section, the model and the description do not go together.
    """
    settings, roles, path = bench.simulation, description.roles, bench.simulation_model
    if settings is None or path is None:
        raise InputError(f"{bench.source or bench.name}: there is no simulation section, so nothing to simulate")
    if roles is None or not set(bench.sensors) <= set(roles.sensors):
        raise InputError(
            f"{bench.source or bench.name}: imu.description: {bench.imu.description} does not say which fields are the "
            f"rates of sensor {', '.join(map(str, bench.sensors))}"
        )
    model = load_model(path)
    for number in bench.sensors:
        model.check_sensor(bench.sensor(number), path)
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
    rate_hz = bench.imu.rate or description.sample_rate_hz
    unit = SimulatedUnit(
        bench,
        model,
        roles,
        plant,
        sample_rate_hz=rate_hz,
        begins_s=begins_s,
        first_run=first_run,
        visited=visited,
        session=session,
    )
    imu = SimulatedImu(
        description,
        unit,
        rate_hz=rate_hz,
        identity=ImuIdentity(
            bench.unit.model, "SIM-0001" if bench.unit.serial == ASK else bench.unit.serial, "simulated"
        ),
        index=IndexSettings(bench.position_codes, settings.start.position, settings.index_time),
        faults=settings.imu_faults,
        starts_s=begins_s,
        seed=settings.seed,
    )
    options = SimulatorOptions(
        address=bench.chamber.address,
        terminator=bench.chamber.terminator_bytes,
        framing=bench.chamber.framing,
        description=bench.chamber_description,
        layout=bench.chamber.layout,
        warning_limits=bench.chamber.warning_limits,
        faults=settings.chamber_faults,
        begins_s=begins_s,
    )
    try:
        chamber = CHAMBER_SIMULATORS[bench.chamber.driver](plant, options)
    except ValueError as error:
        raise InputError(f"{bench.source or bench.name}: the simulated chamber: {error}") from error
    return SimulatedBench(imu, chamber, unit, plant, ramp_port_of(chamber))
