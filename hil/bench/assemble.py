"""A bench from its file: clock, ports, unit, chamber, what moves the unit; all above cannot tell what is simulated."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

from drivers.chambers import CHAMBER_DRIVERS, Chamber, ChamberOptions
from drivers.chambers.catalogue import SerialLine
from drivers.chambers.ramp import RampedChamber
from drivers.clock import SIMULATED_EPOCH, Clock, PacedClock, SystemClock, VirtualClock
from drivers.errors import DeviceError, TransportError
from drivers.imu import ImuIdentity
from drivers.imu.stream import StreamImu
from drivers.outside import brought, loaded
from drivers.positioners.indexing import IndexingPositioner
from drivers.positioners.positioner import AskOperator, OperatorPositioner, Positioner
from drivers.simulators import SimulatedDevice
from drivers.simulators.memory import MemoryTransport
from drivers.transports import Transport, open_port
from drivers.transports.live_reader import LiveReader
from drivers.transports.serial_port import SerialTransport, existing_ports, no_such_port
from drivers.transports.transport import ClosedPort, own_port
from hil.bench.advice import closed_port_advice
from hil.bench.lock import port_lock
from hil.config.bench import Bench
from hil.config.ports import COM_PORT, OWN_SCHEME, SIMULATED_SCHEME, unit_port
from hil.config.unit import ASK
from hil.errors import InputError, worded
from hil.twin.devices import FaultInjector, SimulatedBench, simulate_devices
from hil.twin.motion import FROM_THE_START, Resumed
from procedures.devices import BenchDevices

Unopened = Callable[[str, DeviceError], None]
"""Is told the key of the bench file whose port could not be opened, and why."""


@dataclass(frozen=True)
class LiveBench:
    """A bench that is put together and open. `simulators` are the devices in this process, None where all are real."""

    bench: Bench
    devices: BenchDevices
    simulators: SimulatedBench | None = None
    faults: FaultInjector | None = None

    @property
    def simulated(self) -> bool:
        """True where what is measured is simulated, in this process or behind a port."""
        return self.bench.simulated

    @property
    def each(self) -> Mapping[str, Self]:
        """The bench as each unit has it, by the unit's name."""
        units = self.devices.units
        return {name: replace(self, bench=own, devices=units[name]) for name, own in self.bench.each.items()}

    def close(self) -> None:
        """Release the ports; the chamber goes on as it is. Closing twice is allowed."""
        for unit in self.devices.units.values():
            with suppress(DeviceError):
                unit.imu.close()
        with suppress(DeviceError):
            self.devices.chamber.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def build_bench(
    bench: Bench,
    *,
    start_utc: datetime | None = None,
    resumed: Resumed = FROM_THE_START,
    ask: AskOperator | None = None,
    unopened: Unopened | None = None,
    speed: float | None = None,
) -> LiveBench:
    """Put a bench together and open its ports.

    `start_utc` is where a virtual clock begins (a fixed instant where it is not given), so that a night that is
    carried on goes on in time; its simulated chamber begins at the start temperature of the simulation section, as one
    that nobody controlled meanwhile; `resumed` says what went before. `ask` puts questions to the operator of a bench
    without indexing. `speed` keeps a virtual clock to so many times real time, so that a simulated night can be
    watched. Raises `InputError` for a port that does not exist or a file that cannot be used, or a speed for a clock
    that is not virtual, `DeviceError` for a port that cannot be opened; nothing stays open then.
    """
    for own in bench.each.values():
        _ = own.frames  # what cannot be used is said before anything is opened
    where = bench.source or bench.name
    if bench.imu.positioner == "operator" and ask is None:
        raise InputError(f"{where}: imu.positioner: an operator moves the unit, and none is there to ask")
    if unopened is None:
        check_ports(bench)
    clock = clock_of(bench, start_utc, speed)
    with ExitStack() as opened:
        ports = _Ports(bench, clock, opened, unopened, resumed)
        faults = FaultInjector(bench.faults, clock, resumed)
        imus = {name: _imu(name, own, ports) for name, own in bench.each.items()}
        chamber = _chamber(ports, night=True)
        fixture, turned = _fixture(bench, clock, faults, ask), dict[str, Positioner]()
        for name, own in bench.each.items():  # its own index turns each unit, or one operator or fixture all of them
            if fixture is None:
                _refuse_an_index_that_cannot_be_told(own)
            turned[name] = fixture or IndexingPositioner(imus[name], clock, own.position_codes)
        units = {
            name: BenchDevices(clock, imus[name], chamber, turned[name], bench.simulated, own.poses)
            for name, own in bench.each.items()
        }
        devices = replace(next(iter(units.values())), units=units)
        opened.pop_all()
    if not any(port.startswith(SIMULATED_SCHEME) for _, port in ports_of(bench)):
        return LiveBench(bench, devices)
    faults.inject(ports.devices, ports.simulated)
    return LiveBench(bench, devices, ports.devices, faults)


@contextmanager
def open_chamber(bench: Bench) -> Iterator[tuple[Chamber, Clock]]:
    """Give a bench's chamber and clock, and close it. Raises `InputError` and `DeviceError` as `build_bench` does."""
    _check_port(bench, "chamber.port", bench.chamber.port)
    clock = clock_of(bench)
    with ExitStack() as opened:
        chamber = _chamber(_Ports(bench, clock, opened), night=False)
        opened.pop_all()
    try:
        yield chamber, clock
    finally:
        with suppress(DeviceError):
            chamber.close()


def check_ports(bench: Bench) -> None:
    """Raise `InputError` for a port that this machine does not have. Nothing is opened."""
    for key, port in ports_of(bench):
        _check_port(bench, key, port)


def ports_of(bench: Bench) -> list[tuple[str, str]]:
    """Return key and port of everything that the bench file connects."""
    units = [(unit_port(name), each.imu.port) for name, each in bench.each.items()]
    return [*units, ("chamber.port", bench.chamber.port)]


def is_missing(port: str) -> bool:
    """Tell a path that this machine does not have. Network and simulated ports are no paths."""
    if COM_PORT.fullmatch(port):
        return port.upper() not in existing_ports() and not port.startswith("\\\\")
    if "://" in port:
        return False
    try:
        return not Path(port).exists()
    except OSError:  # a name that is too long for any
        return True


def _check_port(bench: Bench, key: str, port: str) -> None:
    if is_missing(port):
        there = no_such_port(port)
        raise InputError(f"{bench.source or bench.name}: {key}: {there}; {closed_port_advice(there, port, bench)}")


@dataclass(eq=False)
class _Ports:
    """Opens the ports of a bench, or what they simulate, and leaves closing them to `opened`, until that is emptied."""

    bench: Bench
    clock: Clock
    opened: ExitStack
    unopened: Unopened | None = None
    resumed: Resumed = FROM_THE_START
    simulated: dict[str, MemoryTransport] = field(default_factory=dict)  # by key

    @cached_property
    def devices(self) -> SimulatedBench:
        """The simulated devices, of a bench that has any."""
        return simulate_devices(self.bench, begins_s=self.clock.now(), resumed=self.resumed)

    def chamber(self) -> Transport:
        """Open the chamber's port."""
        section = self.bench.chamber
        return self._open("chamber.port", section.port, section.line, lambda: self.devices.chamber)

    def unit(self, name: str, url: str, line: SerialLine) -> Transport:
        """Open a unit's port. A real one is drained by a thread from then on; a simulated one needs none."""
        port = self._open(unit_port(name), url, line, lambda: self.devices.imus[name])
        if not isinstance(port, SerialTransport) or isinstance(self.clock, VirtualClock):
            return port
        reader = LiveReader(port, self.clock)
        self.opened.callback(reader.close)
        return reader

    def _open(self, key: str, url: str, line: SerialLine, device: Callable[[], SimulatedDevice]) -> Transport:
        if url.startswith(SIMULATED_SCHEME):
            port: Transport = self.simulated.setdefault(key, MemoryTransport(device(), self.clock, url))
        elif url.startswith(OWN_SCHEME):
            port = own_port(url, self.clock)
        else:
            port = self._real(key, url, line)
        self.opened.callback(port.close)
        return port

    def _real(self, key: str, url: str, line: SerialLine) -> Transport:
        try:
            release = port_lock(url)
            form: dict[str, Any] = {"baudrate": line.baud, "bytesize": line.data_bits, "parity": line.parity}
            try:
                return open_port(url, clock=self.clock, **form, on_close=release)
            except BaseException:
                release()
                raise
        except TransportError as error:
            if self.unopened is None:
                raise
            self.unopened(key, error)
            return ClosedPort(url, self.clock, error)


def clock_of(bench: Bench, start_utc: datetime | None = None, speed: float | None = None) -> Clock:
    """Return the bench's clock as `build_bench` does; raise `InputError` for a speed that cannot be."""
    start_utc = start_utc or SIMULATED_EPOCH
    if speed is None:
        return SystemClock() if bench.clock == "system" else VirtualClock(start_utc)
    if bench.clock == "system":
        raise InputError(f"{bench.source or bench.name}: clock: a speed needs clock: virtual, with simulated devices")
    with worded(InputError, "the "):
        return PacedClock(speed, start_utc)


def _chamber(ports: _Ports, *, night: bool) -> Chamber:
    bench, clock, section, port = ports.bench, ports.clock, ports.bench.chamber, ports.chamber()
    options = ChamberOptions(
        limits=section.limits,
        safe=section.safe_state,
        expected_model=section.model or None,
        native_margin_degC=section.native_margin,
        celsius_confirmed=section.celsius_confirmed,
        dead_man_s=section.night_dead_man if night else section.dead_man,
        dead_man_asked=section.dead_man is not None,
        description=bench.chamber_description,
        **section.spoken,
    )
    with worded(InputError, f"{bench.source or bench.name}: chamber: "):
        chamber = CHAMBER_DRIVERS[section.driver].build(port, clock, options)
        return chamber if section.ramp is None else RampedChamber(chamber, clock, degC_per_min=section.ramp)


def _imu(name: str, bench: Bench, ports: _Ports) -> StreamImu:
    """Open one unit; `bench` is as that unit has it."""
    line = SerialLine(bench.imu.baud or bench.frames.baudrate)
    # Nothing is expected where the unit says no serial number, or nobody knows yet which.
    serial = bench.unit.serial if bench.frames.tells_serial and bench.unit.serial != ASK else ""
    port = ports.unit(name, bench.imu.port, line)
    return StreamImu(port, bench.frames, ports.clock, expected=ImuIdentity(bench.unit.model, serial))


def _fixture(bench: Bench, clock: Clock, faults: FaultInjector, ask: AskOperator | None) -> Positioner | None:
    hands = faults.hands(bench.positions) if bench.imu.port.startswith(SIMULATED_SCHEME) else None
    if ask is not None and bench.imu.positioner == "operator":
        return OperatorPositioner(faults.answering(ask), clock, instructions=bench.imu.instructions, hands=hands)
    if (outside := brought("hil.positioners").get(bench.imu.positioner)) is not None:
        given = {"clock": clock, "codes": bench.position_codes, "hands": hands}
        return cast(Positioner, loaded(outside)(**given, **bench.imu.positioner_options))
    return None


def _refuse_an_index_that_cannot_be_told(bench: Bench) -> None:
    """Raise `InputError` where the first index move could only fail, hours into the night."""
    where, codes, description = f"{bench.source or bench.name}: imu", bench.position_codes, bench.frames
    if bench.imu.positioner != "indexing":
        return
    if description.commands is None or description.commands.index is None:
        raise InputError(f"{where}.positioner: {description.name} has no index command; write positioner: operator")
    for label, code in codes.items():
        twin = next(other for other in codes if codes[other] == code)
        if twin != label:
            raise InputError(f"{where}.codes: positions {twin} and {label} are both the unit's number {code}")
