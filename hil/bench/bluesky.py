"""A bench for Bluesky's RunEngine, by its protocols alone: the chamber is a movable, the unit a readable.

    with bluesky_devices(load_bench("my-bench.yaml")) as (chamber, imu):
        RE(scan([imu], chamber, -20.0, 60.0, 5))

Staging confirms who is there and prepares the chamber; unstaging brings it to its safe state, as does the end of the
`with` block where a plan did not. What is simulated says so in the source of its values.
The interlocks and the restabilisation of `hil run` are not here: what a night must prove is a night's.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event, RLock
from typing import Any

from drivers.errors import DeviceError, DeviceTimeout
from drivers.imu.samples import rate_fields
from hil.bench.assemble import LiveBench, build_bench
from hil.config import Bench
from hil.errors import InputError
from procedures.averaging import average_series
from procedures.collect import join

_CHAMBER_S, _STREAM_S = 1.0, 0.2  # between looks
Values = Mapping[str, tuple[float, str]]  # with their units


class DeviceStatus:
    """What goes on in a thread, as Bluesky's Status."""

    def __init__(self, future: Future[None]) -> None:
        self._future = future

    def add_callback(self, callback: Callable[["DeviceStatus"], None]) -> None:
        """Call `callback` with this status when it has ended, at once where it has."""
        self._future.add_done_callback(lambda _: callback(self))

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return what it failed with, None where it succeeded; `TimeoutError` where it goes on after `timeout`, s."""
        return self._future.exception(timeout)

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._future.done()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and self._future.exception() is None


class _Device(ABC):
    """What both are: named, readable, done in threads one at a time."""

    parent = None

    def __init__(self, name: str, live: LiveBench, threads: ThreadPoolExecutor, lock: RLock) -> None:
        self.name, self._source = name, f"{'SIMULATED ' * live.bench.simulated}{live.bench.name}"
        self._devices, self._clock = live.devices, live.devices.clock
        self._threads, self._lock = threads, lock

    @abstractmethod
    def _values(self) -> Values:
        """Return what is known now, by name."""

    def read(self) -> dict[str, Any]:
        """Return the present values, with the time at which they were asked."""
        stamp = self._clock.utc().timestamp()
        return {key: {"value": value, "timestamp": stamp} for key, (value, _) in self._values().items()}

    def describe(self) -> dict[str, Any]:
        """Return what the values are, and their units."""
        return {
            key: {"source": f"{self._source}:{key}", "dtype": "number", "shape": [], "units": unit}
            for key, (_, unit) in self._values().items()
        }


class MovableChamber(_Device):
    """The chamber: set to a temperature in °C, there when the air has been `within_degC` of it for `held_s`.

    A move fails with a `DeviceError`: an alarm, `DeviceTimeout` after `timeout_s`, stopped, or as the driver raises.
    """

    within_degC, held_s, timeout_s = 0.5, 60.0, 4 * 3600.0

    def __init__(self, *common: Any) -> None:
        super().__init__("chamber", *common)
        self._chamber, self._stopped = self._devices.chamber, Event()
        self.ours = False  # from the first command until it is in its safe state

    @property
    def hints(self) -> dict[str, list[str]]:
        """What is plotted of it."""
        return {"fields": [self.name]}

    def stage(self) -> list[Any]:
        """Confirm model and unit, set its own limits, and let it condition."""
        with self._lock:
            self._devices.refuse_undeclared_simulation(self._chamber.identify().model)
            self.ours = True
            self._chamber.prepare()
        return [self]

    def unstage(self) -> list[Any]:
        """Bring it to its safe state."""
        self._stopped.set()
        with self._lock:
            self._chamber.safe_state()
            self.ours = False
        return [self]

    def set(self, value: float) -> DeviceStatus:
        """Begin to go to a temperature, °C, staged if it is not; a setpoint that is refused fails the status."""
        self._stopped = stopped = Event()
        return DeviceStatus(self._threads.submit(self._go, float(value), stopped))

    def stop(self, success: bool = False) -> None:
        """Wait for the temperature no longer; unless that is a success, bring the chamber to its safe state."""
        self._stopped.set()
        if not success:
            self.unstage()

    def _values(self) -> Values:
        with self._lock:
            found = self._chamber.read()
        return {self.name: (found.temperature_degC, "degC"), f"{self.name}_setpoint": (found.setpoint_degC, "degC")}

    def _go(self, setpoint_degC: float, stopped: Event) -> None:
        with self._lock:
            if stopped.is_set():
                raise DeviceError(f"{self.name}: stopped before it went to {setpoint_degC:g} °C")
            if not self.ours:
                self.stage()
            self._chamber.set_temperature(setpoint_degC)
        begun_s = outside_s = self._clock.now()
        while self._clock.now() - outside_s < self.held_s:
            self._clock.sleep(_CHAMBER_S)
            with self._lock:
                found = self._chamber.read()
            if found.alarms:
                raise DeviceError(f"{self.name}: the chamber reports {', '.join(found.alarms)}")
            if stopped.is_set():
                raise DeviceError(f"{self.name}: stopped at {found.temperature_degC:.1f} °C")
            if abs(found.temperature_degC - setpoint_degC) > self.within_degC:
                outside_s = self._clock.now()
            if self._clock.now() - begun_s > self.timeout_s:
                raise DeviceTimeout(
                    f"{self.name}: at {found.temperature_degC:.1f} °C after {self.timeout_s:g} s, not {setpoint_degC:g}"
                )


class ReadableImu(_Device):
    """The unit: `trigger` averages its rates over `seconds`; each with its standard error, deg/hr."""

    seconds = 10.0

    def __init__(self, *common: Any) -> None:
        super().__init__("imu", *common)
        self._imu = self._devices.imu
        self._fields = {f"imu_{key.replace('.', '_')}": of for key, of in rate_fields(self._imu.sensors).items()}
        self._found = {f"{key}{end}": (float("nan"), "deg/hr") for key in self._fields for end in ("", "_se")}

    def stage(self) -> list[Any]:
        """Confirm who streams."""
        with self._lock:
            self._devices.refuse_undeclared_simulation(self._imu.identify().model)
        return [self]

    def unstage(self) -> list[Any]:
        """Leave it streaming."""
        return [self]

    def trigger(self) -> DeviceStatus:
        """Begin to average; a stream that gives nothing fails the status."""
        return DeviceStatus(self._threads.submit(self._average))

    def _values(self) -> Values:
        return self._found

    def _average(self) -> None:
        self._imu.discard()
        blocks, until_s = [], self._clock.now() + self.seconds
        while self._clock.now() < until_s:
            self._clock.sleep(_STREAM_S)
            blocks.append(self._imu.read_block())
        samples = join(blocks)
        for key, field in self._fields.items():
            if not len(samples) or field not in samples.fields:
                raise DeviceTimeout(f"{self.name}: no sample of {key} in {self.seconds:g} s; check unit and cable")
            found = average_series(samples.time_s, samples.fields[field][:, None])
            self._found |= {key: (float(found.mean[0]), "deg/hr"), f"{key}_se": (float(found.se[0]), "deg/hr")}


@contextmanager
def bluesky_devices(bench: Bench) -> Iterator[tuple[MovableChamber, ReadableImu]]:
    """Open a bench of one unit; give its chamber and its unit, and close it.

    Raises as `build_bench` does, and `InputError` where the bench lists several units.
    """
    if bench.units:
        raise InputError(
            f"{bench.source}: units: Bluesky is lent a bench of one unit; this one lists {len(bench.units)}"
        )
    with build_bench(bench) as live, ThreadPoolExecutor(2) as threads:
        common = live, threads, RLock()
        chamber = MovableChamber(*common)
        try:
            yield chamber, ReadableImu(*common)
        finally:
            if chamber.ours:
                chamber.unstage()
