# ruff: noqa: D102, ARG005, S610 - fakes of Protocols: the Protocols say what each method does
"""A bench of small fakes under the virtual clock, and a journal that is a list and can die at any call."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from drivers.chambers import ChamberLimits, ChamberReading, SafeState
from drivers.chambers.chamber import ChamberIdentity
from drivers.clock import VirtualClock
from drivers.errors import DeviceError, DeviceTimeout
from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole
from drivers.imu import ImuIdentity, SampleBlock
from procedures.devices import BenchDevices
from procedures.journal_protocol import Ended, Outcome, StepResult
from procedures.plan import Plan, Step, make_plan
from procedures.sequencer import Sequencer
from procedures.settings import CollectSettings, InterlockSettings, Polling, Restabilisation, SweepProcedure
from procedures.stop import StopRequest
from procedures.sweep_outcome import SweepOutcome
from procedures.watch import Watch

BEGAN = datetime(1985, 10, 1, 17, 0, tzinfo=UTC)
RATE_HZ = 20.0
TRUE_RATES = {"1": 5.0, "2": -3.0, "3": 11.0}
_PATTERN = np.array([1.0, -2.0, 0.5, 2.0, -1.5, 0.25, -0.75, 0.5])


MOST_ATTEMPTS = 30  # at one step, over all the controllers of a test; nothing is meant to be tried a tenth as often


class Killed(BaseException):
    """The process died here."""


class FakeChamber:
    """Ramps to its setpoint, 3 °C/min unless told otherwise. Faults are functions of time."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.limits = ChamberLimits(-45.0, 75.0)
        self.setpoint_degC = 23.0
        self._air, self._at = 23.0, 0.0
        self.prepared = self.safe = False
        self.prepared_first: bool | None = None  # whether `prepare` came before the first setpoint
        self.safe_calls = 0
        self.safe_fails = 0
        self.dead = False  # the controller died: nothing it would still do reaches the chamber
        self.stuck = False
        self.state = SafeState("hold", 23.0)
        self.lies = False  # acknowledges the safe state and goes on as it was
        self.ramp_degC_per_min = 3.0
        self.alarm: Callable[[float], tuple[str, ...]] = lambda t: ()
        self.silent: Callable[[float], bool] = lambda t: False
        self.offset_degC: Callable[[float], float] = lambda t: 0.0

    def air_degC(self) -> float:
        t = self.clock.now()
        reach = 0.0 if self.stuck else self.ramp_degC_per_min * (t - self._at) / 60.0
        self._air += math.copysign(min(abs(self.setpoint_degC - self._air), reach), self.setpoint_degC - self._air)
        self._at = t
        return self._air + self.offset_degC(t)

    def _answer(self) -> None:
        if self.silent(self.clock.now()):
            raise DeviceTimeout("the chamber at sim://chamber sent nothing within 1 s")

    def identify(self) -> ChamberIdentity:
        self._answer()
        return ChamberIdentity("FAKE", "degC")

    def prepare(self) -> None:
        self._answer()
        self.prepared, self.safe = True, False

    def read(self) -> ChamberReading:
        self._answer()
        t = self.clock.now()
        return ChamberReading(self.air_degC(), self.setpoint_degC, 80.0, -50.0, "CONSTANT", self.alarm(t))

    def set_temperature(self, setpoint_degC: float) -> None:
        self._answer()
        if self.prepared_first is None:
            self.prepared_first = self.prepared
        self.air_degC()
        self.setpoint_degC = setpoint_degC

    def safe_state(self) -> SafeState:
        if self.dead:
            return self.state
        self.safe_calls += 1
        if self.safe_fails:
            self.safe_fails -= 1
            raise DeviceTimeout("the chamber at sim://chamber sent nothing within 1 s")
        self.safe = True
        if not self.lies:
            self.set_temperature(23.0)
        return self.state

    def close(self) -> None:
        pass


class FakeImu:
    """Streams 20 samples a second of a constant per position, with a fixed pattern that begins anew at `discard`."""

    sample_rate_hz = RATE_HZ
    conditions: Mapping[str, str] = {"supply_V": "supply_V"}

    def __init__(self, clock: VirtualClock, chamber: FakeChamber, table: FakeTable) -> None:
        self.clock, self.chamber, self.table = clock, chamber, table
        self.sensors = {
            2: SensorRole(
                rates={"RA": "rate_A2"},
                accelerations={"A": "accel_A2"},
                temperature="rotor_2_degC",
                conditions={"spin_period_us": "spin_2_us"},
            )
        }
        self.serial = "7"
        self.port, self.unsure = "sim://imu", False
        self._sent = clock.now()
        self._k = 0
        self._unit, self._unit_at = chamber.air_degC(), clock.now()
        self.silent: Callable[[float], bool] = lambda t: False
        self.broken: Callable[[float], bool] = lambda t: False
        self.damaged: Callable[[float], bool] = lambda t: False
        self.extra: Callable[[np.ndarray], np.ndarray] = np.zeros_like  # deg/hr on top of the rate, by time
        self.extra_accel: Callable[[np.ndarray], np.ndarray] = np.zeros_like

    def _unit_degC(self) -> float:
        now = self.clock.now()
        air = self.chamber.air_degC()
        self._unit = air + (self._unit - air) * math.exp(-(now - self._unit_at) / 300.0)
        self._unit_at = now
        return self._unit

    def identify(self) -> ImuIdentity:
        self.unsure = False
        return ImuIdentity("FAKE", self.serial)

    def read_block(self) -> SampleBlock:
        now = self.clock.now()
        if self.broken(now):
            raise DeviceError("the port sim://imu is gone")
        n = int((now - self._sent) * RATE_HZ + 1e-6)
        times = self._sent + np.arange(1, n + 1) / RATE_HZ
        if n:
            self._sent = float(times[-1])
        k = self._k + np.arange(n)
        self._k += n
        kept = np.array([not self.silent(t) for t in times], dtype=bool)
        times, k = times[kept], k[kept]
        rate = TRUE_RATES.get(self.table.where or "", 0.0) + _PATTERN[k % 8] + self.extra(times)
        whole = np.ones(len(times))
        fields = {
            "rate_A2": rate,
            "accel_A2": 0.5 * whole + self.extra_accel(times),
            "rotor_2_degC": self._unit_degC() * whole,
            "spin_2_us": 10000.0 * whole,
            "supply_V": 28.0 * whole,
        }
        if self.damaged(now):
            return SampleBlock(np.empty(0), {}, StreamCounts(bad_checksum=n), b"x" * n)
        return SampleBlock(times, fields, StreamCounts(ok=len(times)), b"x" * len(times), now)

    def discard(self) -> StreamCounts:
        self._sent, self._k = self.clock.now(), 0
        return StreamCounts()

    def close(self) -> None:
        pass


class FakeTable:
    """Moves in 5 s. `refuse` of the next moves time out; `ends_at` is where it ends up instead of where it should."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.where: str | None = None
        self.refuse = 0
        self.ends_at: str | None = None
        self.moves: list[str] = []

    def move_to(self, position: str, timeout_s: float) -> None:
        self.moves.append(position)
        self.clock.sleep(5.0)
        if self.refuse:
            self.refuse -= 1
            self.where = None
            raise DeviceTimeout(f"position {position} was not confirmed within {timeout_s:g} s")
        self.where = self.ends_at or position

    def position(self) -> str | None:
        return self.where


@dataclass
class Record:
    """What survives a death: results by key, every begin and end, events, signs of life."""

    results: dict[str, StepResult] = field(default_factory=dict)
    begins: list[str] = field(default_factory=list)
    ends: list[tuple[str, int, StepResult]] = field(default_factory=list)
    events: list[tuple[str, str, Mapping[str, Any]]] = field(default_factory=list)
    heartbeats: list[tuple[str, Mapping[str, float]]] = field(default_factory=list)

    def kinds(self) -> list[str]:
        return [kind for kind, _, _ in self.events]


class ListJournal:
    """A journal over a `Record`. `fails(call, what)` may raise before or after the call takes effect."""

    def __init__(self, record: Record, fails: Callable[[int, str], None] = lambda call, when: None) -> None:
        self.record, self._fails, self.calls = record, fails, 0

    def _around(self, act: Callable[[], Any]) -> Any:
        self.calls += 1
        call = self.calls
        self._fails(call, "before")
        result = act()
        self._fails(call, "after")
        return result

    def completed(self) -> Mapping[str, StepResult]:
        return self._around(lambda: dict(self.record.results))

    def begin(self, *steps: Step) -> Sequence[int]:
        def act() -> Sequence[int]:
            self.record.begins += [step.key for step in steps]
            attempts = [self.record.begins.count(step.key) for step in steps]
            if max(attempts) > MOST_ATTEMPTS:
                pytest.fail(f"{steps[0].key} is tried without end")
            return attempts

        return self._around(act)

    def end(self, *ended: Ended) -> None:
        def act() -> None:
            for step, attempt, result in ended:
                assert step.key not in self.record.results, f"{step.key} was DONE and got a second result"
                self.record.ends.append((step.key, attempt, result))
                if result.outcome is Outcome.DONE:
                    self.record.results[step.key] = replace(result, samples=None)

        self._around(act)

    def event(self, kind: str, message: str, **evidence: Any) -> None:
        self._around(lambda: self.record.events.append((kind, message, evidence)))

    def heartbeat(self, step: Step, readings: Mapping[str, float]) -> None:
        self._around(lambda: self.record.heartbeats.append((step.key, readings)))


SWEEP = SweepProcedure(
    title="two temperatures",
    temperatures_degC=(20.0, 26.0),
    self_calibrations=1,
    positions=("1", "2"),
    restabilisation=Restabilisation(at_least_s=600.0, window_s=300.0, ceiling_s=3600.0),
    collect=CollectSettings(settle_s=10.0, duration_s=60.0),
    final_degC=23.0,
)


class FakeBench:
    """The fakes together; `run` makes a new controller on the same bench and record, as after a death."""

    def __init__(self) -> None:
        self.clock = VirtualClock(BEGAN)
        self.chamber = FakeChamber(self.clock)
        self.table = FakeTable(self.clock)
        self.imu = FakeImu(self.clock, self.chamber, self.table)
        self.record = Record()
        self.stop = StopRequest()
        self.sweep = SWEEP
        self.interlocks = InterlockSettings()
        self.polling = Polling(interval_s=10.0, read_interval_s=10.0)
        self.simulation_declared = True

    @property
    def devices(self) -> BenchDevices:
        return BenchDevices(
            self.clock, self.imu, self.chamber, self.table, simulation_declared=self.simulation_declared
        )

    @property
    def plan(self) -> Plan:
        return make_plan(self.sweep)

    def run(self, fails: Callable[[int, str], None] = lambda call, when: None, **more: Any) -> SweepOutcome:
        self.journal = ListJournal(self.record, fails)
        of_sequencer = more.keys() & {"powered_on", "attendant", "first"}
        own = {"powered_on": BEGAN} | {name: more.pop(name) for name in of_sequencer}
        more = {"began": BEGAN, "interlocks": self.interlocks, "polling": self.polling} | more
        return Sequencer(self.plan, Watch(self.devices, self.journal, self.stop, **more), **own).run()

    def reboot(self, after_s: float = 3600.0) -> None:
        """The power came back: the unit's position is not known, the stream begins anew."""
        self.clock.sleep(after_s)
        self.chamber.dead = False
        self.table.where = None
        self.imu.discard()
        self.stop = StopRequest()

    def collects(self) -> dict[str, Mapping[str, Any]]:
        return {key: result.data for key, result in self.record.results.items() if key.endswith("collect")}


@pytest.fixture
def bench() -> FakeBench:
    """A bench of fakes with a short sweep."""
    return FakeBench()


@pytest.fixture
def new_bench() -> Callable[[], FakeBench]:
    """A factory of benches of fakes, for tests that need many."""
    return FakeBench


@pytest.fixture
def killed() -> type[BaseException]:
    """What a journal raises where the process dies."""
    return Killed
