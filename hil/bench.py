"""Putting a bench together: clock, ports, unit, chamber and what moves the unit, from its file.

    with build_bench(load_bench("simulated")) as bench:
        bench.devices.imu.identify()

This is the only place that knows that `sim://` ports are simulated devices in this process. Everything above gets
devices and cannot tell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.chamber import Chamber, ChamberLimits
from drivers.chambers import CHAMBER_DRIVERS, ChamberOptions, SerialLine
from drivers.clock import Clock, SystemClock, VirtualClock
from drivers.errors import DeviceError
from drivers.frames.description import DescriptionError, StreamDescription, load_description
from drivers.imu import ImuIdentity
from drivers.operator import AskOperator, OperatorPositioner
from drivers.port_owner import owned
from drivers.positioner import Positioner
from drivers.ramp import RampedChamber
from drivers.serial_port import existing_ports, open_port
from drivers.simulators import SimulatedDevice
from drivers.simulators.memory import MemoryTransport
from drivers.stream_imu import IndexingPositioner, StreamImu
from drivers.transport import Transport
from hil.config.bench import SIMULATED_SCHEME, Bench
from hil.errors import InputError
from hil.twin.devices import SimulatedBench, simulate_devices
from procedures.bench import BenchDevices


@dataclass(frozen=True)
class LiveBench:
    """A bench that is put together and open. `simulators` are the devices in this process, None where all are real."""

    bench: Bench
    description: StreamDescription
    devices: BenchDevices
    simulators: SimulatedBench | None = None

    @property
    def simulated(self) -> bool:
        """True where what is measured is simulated, in this process or behind a port."""
        return self.bench.simulated

    def close(self) -> None:
        """Release the ports; the chamber goes on as it is. Closing twice is allowed."""
        with suppress(DeviceError):
            self.devices.imu.close()
        with suppress(DeviceError):
            self.devices.chamber.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def build_bench(
    bench: Bench,
    *,
    start_utc: datetime | None = None,
    first_run: int = 1,
    visited: Sequence[str] = (),
    session: int = 0,
    ask: AskOperator | None = None,
) -> LiveBench:
    """Put a bench together and open its ports.

    `start_utc` is where a virtual clock begins (a fixed instant where it is not given), so that a night that is
    carried on goes on in time; its simulated chamber begins at the start temperature of the simulation section, as one
    that nobody controlled meanwhile. `first_run`, `visited` and `session` are those of `simulate_devices`. `ask` puts
    questions to the operator of a bench without indexing. Raises `InputError` for a port that does not exist or a file
    that cannot be used, `DeviceError` for a port that cannot be opened; nothing stays open then.
    """
    description = load_frames(bench)
    if bench.imu.positioner == "operator" and ask is None:
        raise InputError(
            f"{bench.source or bench.name}: imu.positioner: an operator moves the unit, and none is there to ask"
        )
    check_ports(bench)
    clock = _clock(bench, start_utc)

    @cache
    def simulators() -> SimulatedBench:
        return simulate_devices(
            bench, description, begins_s=clock.now(), first_run=first_run, visited=visited, session=session
        )

    def transport(url: str, line: SerialLine, device: Callable[[], SimulatedDevice]) -> Transport:
        if url.startswith(SIMULATED_SCHEME):
            return MemoryTransport(device(), clock, url)
        if line.data_bits == 8 and line.parity == "N":
            return owned(url, lambda: open_port(url, clock=clock, baudrate=line.baud))
        return owned(
            url, lambda: open_port(url, clock=clock, baudrate=line.baud, bytesize=line.data_bits, parity=line.parity)
        )

    with ExitStack() as opened:
        baud = bench.imu.baud or description.baudrate
        imu_port = transport(bench.imu.port, SerialLine(baud), lambda: simulators().imu)
        opened.callback(imu_port.close)
        chamber_port = transport(bench.chamber.port, bench.chamber.line, lambda: simulators().chamber)
        opened.callback(chamber_port.close)
        ramp_url = bench.chamber.ramp_port
        ramp_port = None if ramp_url is None else owned(ramp_url, lambda: open_port(ramp_url, clock=clock))
        if ramp_port is not None:
            opened.callback(ramp_port.close)
        imu = StreamImu(
            imu_port,
            description,
            clock,
            sample_rate_hz=bench.imu.rate,
            expected=ImuIdentity(bench.unit.model, bench.unit.serial),
        )
        devices = BenchDevices(
            clock, imu, _chamber(bench, chamber_port, ramp_port, clock), _positioner(bench, imu, clock, ask)
        )
        opened.pop_all()
    in_process = bench.imu.port.startswith(SIMULATED_SCHEME) or bench.chamber.port.startswith(SIMULATED_SCHEME)
    return LiveBench(bench, description, devices, simulators() if in_process else None)


def load_frames(bench: Bench) -> StreamDescription:
    """Load the IMU's frame description; raise `InputError` where it cannot be used."""
    try:
        return load_description(bench.imu_description)
    except DescriptionError as error:
        raise InputError(str(error)) from error


def check_ports(bench: Bench) -> None:
    """Raise `InputError` for a port that this machine does not have. Nothing is opened."""
    for key, port in (("imu.port", bench.imu.port), ("chamber.port", bench.chamber.port)):
        if "://" not in port and not port.upper().startswith("COM") and not Path(port).exists():
            there = ", ".join(existing_ports()) or "none"
            raise InputError(
                f"{bench.source or bench.name}: {key}: the port {port} does not exist; ports on this machine: {there}"
            )


def _clock(bench: Bench, start_utc: datetime | None) -> Clock:
    if bench.clock == "system":
        return SystemClock()
    return VirtualClock() if start_utc is None else VirtualClock(start_utc)


def _chamber(bench: Bench, port: Transport, ramp_port: Transport | None, clock: Clock) -> Chamber:
    section = bench.chamber
    options = ChamberOptions(
        limits=ChamberLimits(section.limits.low, section.limits.high),
        safe=section.safe_state,
        expected_model=section.model or None,
        address=section.address,
        terminator=section.terminator_bytes,
        native_margin_degC=section.native_margin,
        celsius_confirmed=section.celsius_confirmed,
        ramp_port=ramp_port,
        framing=section.framing,
        description=bench.chamber_description,
        dead_man_s=section.dead_man,
    )
    try:
        chamber = CHAMBER_DRIVERS[section.driver].build(port, clock, options)
        return chamber if section.ramp is None else RampedChamber(chamber, clock, degC_per_min=section.ramp)
    except ValueError as error:
        raise InputError(f"{bench.source or bench.name}: chamber: {error}") from error


def _positioner(bench: Bench, imu: StreamImu, clock: Clock, ask: AskOperator | None) -> Positioner:
    if ask is not None and bench.imu.positioner == "operator":
        return OperatorPositioner(ask, clock, instructions=bench.imu.instructions)
    return IndexingPositioner(imu, clock, bench.position_codes)
