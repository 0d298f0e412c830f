"""The ESPEC driver against the simulated controller: a night's work, and every way in which it is disturbed."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.chamber import Chamber, ChamberLimits, SafeState
from drivers.clock import VirtualClock
from drivers.errors import (
    CommandRefused,
    DeviceError,
    DeviceTimeout,
    ProtocolError,
    SensorFault,
    SetpointOutOfLimits,
    TransportError,
)
from drivers.espec import EspecChamber
from drivers.simulators.chamber_plant import ChamberPlant
from drivers.simulators.espec import EspecFault, FaultKind, SimulatedEspec
from drivers.simulators.memory import MemoryTransport

LIMITS = ChamberLimits(-35.0, 65.0)
HOLD = SafeState("hold", 25.0)


class _Wire:
    """The simulated device, with every byte that the host sends kept."""

    def __init__(self, device: SimulatedEspec) -> None:
        self.device = device
        self.sent = b""

    def receive(self, data: bytes, now_s: float) -> None:
        self.sent += data
        self.device.receive(data, now_s)

    def transmit(self, now_s: float) -> bytes:
        return self.device.transmit(now_s)

    def next_transmission(self, now_s: float) -> float | None:
        return self.device.next_transmission(now_s)

    def count(self, command: str) -> int:
        return self.sent.count(command.encode())


class _Bench:
    """A chamber, its controller, its air, and the clock they share."""

    def __init__(self, safe: SafeState = HOLD, **device: Any) -> None:
        self.clock = VirtualClock()
        self.plant = ChamberPlant()
        self.device = SimulatedEspec(self.plant, **device)
        self.wire = _Wire(self.device)
        self.transport = MemoryTransport(self.wire, self.clock, "sim://chamber")
        self.chamber = EspecChamber(self.transport, self.clock, limits=LIMITS, safe=safe, expected_model="P3")

    def fault(self, kind: FaultKind, **details: Any) -> None:
        self.device.inject(EspecFault(kind, **({"begins_s": self.clock.now()} | details)))


def test_a_setpoint_is_reached_within_limits_and_with_all_pauses_kept() -> None:
    """Identify, prepare, set, wait: no request came too early, and the chamber's own limits are in force."""
    bench = _Bench(setpoint_degC=85.0)
    chamber: Chamber = bench.chamber
    assert chamber.identify().model == "P300 SIMULATED 1.00"
    chamber.prepare()
    chamber.set_temperature(-29.7222)
    bench.clock.sleep(3600.0)
    reading = chamber.read()
    assert reading.temperature_degC == pytest.approx(-29.7, abs=0.1)
    assert (reading.setpoint_degC, reading.low_limit_degC, reading.high_limit_degC) == (-29.7, -40.0, 70.0)
    assert reading.mode == "CONSTANT"
    assert reading.alarms == ()
    assert bench.device.ignored_requests == 0


def test_impatience_would_be_noticed() -> None:
    """The simulator ignores what comes too early, so the pauses above are proven, not assumed."""
    bench = _Bench()
    bench.chamber.identify()
    bench.transport.write(b"MON?\r\n")
    assert bench.device.ignored_requests == 1


def test_starting_outside_the_limits_raises_no_alarm_and_the_limits_follow() -> None:
    """A bench for 30 to 65 °C begins in a room of 22 °C; once the air is inside, the next setpoint tightens."""
    bench = _Bench()
    chamber = EspecChamber(bench.transport, bench.clock, limits=ChamberLimits(30.0, 65.0), safe=SafeState("off"))
    chamber.prepare()
    chamber.set_temperature(45.0)
    reading = chamber.read()
    assert (reading.low_limit_degC, reading.mode, reading.alarms) == (17.0, "CONSTANT", ())
    bench.clock.sleep(3600.0)
    chamber.set_temperature(50.0)
    reading = chamber.read()
    assert (reading.low_limit_degC, reading.mode, reading.alarms) == (25.0, "CONSTANT", ())


def test_the_limits_are_those_of_the_bench_file() -> None:
    """Procedures plan within them."""
    assert _Bench().chamber.limits == LIMITS


def test_a_safe_state_outside_the_limits_is_refused_at_once() -> None:
    """Not at three in the morning, when it is needed."""
    with pytest.raises(SetpointOutOfLimits):
        _Bench(safe=SafeState("hold", 90.0))


@pytest.mark.parametrize("kind", [FaultKind.DEAF, FaultKind.SILENCE, FaultKind.GARBAGE, FaultKind.TRUNCATED])
@pytest.mark.parametrize("command", ["TEMP?", "MON?", "ALARM?", "ROM?", "TYPE?"])
def test_one_disturbed_answer_does_not_end_the_night(kind: FaultKind, command: str) -> None:
    """A read is asked again, whatever became of its first answer."""
    bench = _Bench()
    bench.fault(kind, command=command, times=2)
    bench.chamber.prepare()
    assert bench.chamber.read().mode == "CONSTANT"


@pytest.mark.parametrize("kind", [FaultKind.SILENCE, FaultKind.GARBAGE, FaultKind.TRUNCATED])
def test_a_write_carried_out_without_a_good_reply_is_sent_once(kind: FaultKind) -> None:
    """Reading back shows that it holds."""
    bench = _Bench()
    bench.chamber.prepare()
    bench.fault(kind, command="TEMP,S")
    bench.chamber.set_temperature(60.0)
    assert bench.device.setpoint_degC == 60.0
    assert bench.wire.count("TEMP,S60.0") == 1


def test_a_write_that_never_arrived_is_an_error_and_is_not_repeated() -> None:
    """Reading back shows the old setpoint; whether to try again is the procedure's decision."""
    bench = _Bench()
    bench.chamber.prepare()
    bench.fault(FaultKind.DEAF, command="TEMP,S")
    with pytest.raises(ProtocolError, match="reads back setpoint 22 °C instead of 60 °C"):
        bench.chamber.set_temperature(60.0)
    assert bench.wire.count("TEMP,S60.0") == 1


@pytest.mark.parametrize("delay_s", [0.5, 1.9, 2.2, 2.5, 3.0, 5.0, 8.0])
@pytest.mark.parametrize("command", ["TEMP?", "MON?", "TEMP,S", "MODE"])
def test_a_late_reply_never_answers_another_request(delay_s: float, command: str) -> None:
    """Wherever it lands, the setpoint is right, the reading is today's, and nothing was written twice."""
    bench = _Bench()
    bench.fault(FaultKind.LATE, command=command, delay_s=delay_s)
    bench.chamber.prepare()
    bench.fault(FaultKind.LATE, command=command, delay_s=delay_s)
    bench.chamber.set_temperature(60.0)
    bench.clock.sleep(3600.0)
    bench.fault(FaultKind.LATE, command=command, delay_s=delay_s)
    reading = bench.chamber.read()
    assert reading.setpoint_degC == 60.0
    assert reading.temperature_degC == pytest.approx(60.0, abs=0.1)
    assert bench.wire.count("TEMP,S60.0") == 1


def test_a_dead_controller_is_named_within_its_deadline() -> None:
    """Three times two seconds and the pauses."""
    bench = _Bench()
    bench.fault(FaultKind.SILENCE, times=None)
    with pytest.raises(DeviceTimeout, match=r"chamber on sim://chamber did not answer 'TEMP\?'"):
        bench.chamber.read()
    assert bench.clock.now() < 8.0


@pytest.mark.parametrize("text", ["PROTECT ON", "DATA OUT OF RANGE", "CHB NOT READY", "CONT NOT READY-3"])
def test_a_refused_setpoint_says_what_to_do(text: str) -> None:
    """The controller's own words and a sentence; sent once."""
    bench = _Bench()
    bench.chamber.prepare()
    bench.fault(FaultKind.REFUSED, command="TEMP,S", text=text)
    with pytest.raises(CommandRefused, match=text):
        bench.chamber.set_temperature(60.0)
    assert bench.wire.count("TEMP,S60.0") == 1


def test_an_alarm_is_reported_for_as_long_as_it_stands() -> None:
    """Nothing that the driver sends acknowledges it; only the panel does."""
    bench = _Bench()
    bench.chamber.prepare()
    bench.fault(FaultKind.ALARM, text="19")
    for _ in range(3):
        assert bench.chamber.read().alarms == ("alarm 19",)
    bench.device.acknowledge_alarms()
    assert bench.chamber.read().alarms == ()


def test_after_a_power_cycle_the_chamber_must_be_prepared_anew() -> None:
    """The setpoint alone would be taken and nothing would happen."""
    bench = _Bench()
    bench.chamber.prepare()
    bench.chamber.set_temperature(45.0)
    bench.clock.sleep(1800.0)
    bench.fault(FaultKind.POWER_CYCLE)
    assert bench.chamber.read().mode == "OFF"
    with pytest.raises(CommandRefused, match="mode OFF"):
        bench.chamber.set_temperature(45.0)
    bench.chamber.prepare()
    bench.chamber.set_temperature(45.0)
    assert bench.chamber.read().mode == "CONSTANT"


@pytest.mark.parametrize("text", ["-199.9", "nan", "9999.0", "-3276.8", "---.-"])
def test_a_broken_sensor_is_a_sensor_fault_and_no_temperature(text: str) -> None:
    """It never becomes a reading, and never a setpoint to start from."""
    bench = _Bench()
    bench.fault(FaultKind.SENSOR_BROKEN, text=text)
    with pytest.raises(SensorFault, match="check its temperature sensor"):
        bench.chamber.read()


def test_a_plant_that_does_not_follow_shows_in_the_reading_alone() -> None:
    """The driver reports what is: procedures judge that 22 °C is not 60 °C."""
    bench = _Bench()
    bench.chamber.prepare()
    bench.fault(FaultKind.PLANT_DEAD)
    bench.chamber.set_temperature(60.0)
    bench.clock.sleep(3600.0)
    assert bench.chamber.read().temperature_degC == pytest.approx(22.0)


SAFE_STATES = [HOLD, SafeState("standby"), SafeState("off")]


def _is_safe(device: SimulatedEspec, safe: SafeState) -> bool:
    if safe.action == "hold":
        return device.mode == "CONSTANT" and device.setpoint_degC == safe.temperature_degC
    return device.mode in (("STANDBY", "OFF") if safe.action == "standby" else ("OFF",))


@pytest.mark.parametrize("safe", SAFE_STATES)
@pytest.mark.parametrize("mode", ["OFF", "STANDBY", "CONSTANT", "RUN"])
def test_the_safe_state_is_reached_from_every_mode(
    safe: SafeState, mode: Literal["OFF", "STANDBY", "CONSTANT", "RUN"]
) -> None:
    """Without having identified anything, as a watchdog does; and a second call writes nothing."""
    bench = _Bench(safe, mode=mode, setpoint_degC=80.0)
    bench.chamber.safe_state()
    assert _is_safe(bench.device, safe)
    before = bench.wire.sent
    bench.chamber.safe_state()
    assert set(bench.wire.sent[len(before) :].split()) <= {b"TEMP?", b"MON?"}


@pytest.mark.parametrize("safe", SAFE_STATES)
@pytest.mark.parametrize(
    "kind",
    [
        FaultKind.DEAF,
        FaultKind.SILENCE,
        FaultKind.GARBAGE,
        FaultKind.TRUNCATED,
        FaultKind.LATE,
        FaultKind.REFUSED,
        FaultKind.ALARM,
        FaultKind.POWER_CYCLE,
        FaultKind.SENSOR_BROKEN,
        FaultKind.PLANT_DEAD,
    ],
)
@pytest.mark.parametrize("times", [1, 4, 8])
def test_the_safe_state_is_reached_through_disturbances(safe: SafeState, kind: FaultKind, times: int) -> None:
    """Eight disturbed exchanges in a row, an alarm that has stopped the chamber, a power cut a moment ago."""
    bench = _Bench(safe)
    bench.chamber.prepare()
    bench.chamber.set_temperature(60.0)
    bench.clock.sleep(600.0)
    bench.fault(kind, times=times)
    bench.chamber.safe_state()
    assert _is_safe(bench.device, safe)


@pytest.mark.parametrize("safe", SAFE_STATES)
def test_a_chamber_that_hears_but_does_not_answer_is_made_safe_and_still_reported(safe: SafeState) -> None:
    """A broken receive line: what was sent was carried out, but nobody could confirm it."""
    bench = _Bench(safe, mode="CONSTANT", setpoint_degC=60.0)
    bench.fault(FaultKind.SILENCE, times=None)
    with pytest.raises(DeviceTimeout, match="could not be confirmed in 3 attempts; go to the chamber"):
        bench.chamber.safe_state()
    assert _is_safe(bench.device, safe)
    assert bench.clock.now() < 80.0


def test_a_locked_panel_is_reported_when_the_safe_state_cannot_be_reached() -> None:
    """The reason is the refusal, not merely the setpoint that was read."""
    bench = _Bench(mode="CONSTANT", setpoint_degC=60.0)
    bench.fault(FaultKind.PANEL_LOCK)
    with pytest.raises(CommandRefused, match=r"hold at 25 °C.*PROTECT ON"):
        bench.chamber.safe_state()


def test_a_locked_panel_does_not_matter_where_the_chamber_is_safe() -> None:
    """Nothing needs to be written."""
    bench = _Bench(mode="CONSTANT", setpoint_degC=25.0)
    bench.fault(FaultKind.PANEL_LOCK)
    bench.chamber.safe_state()


def test_a_cable_that_comes_back_in_time_is_enough() -> None:
    """The port fails at first and is there again at the second attempt."""
    bench = _Bench(mode="CONSTANT", setpoint_degC=60.0)

    class Flaky(VirtualClock):
        def sleep(self, seconds: float) -> None:
            super().sleep(seconds)
            if 0.5 < self.now() < 1.5:
                transport.replug()

    clock = Flaky()
    transport = MemoryTransport(bench.wire, clock, "sim://chamber")
    chamber = EspecChamber(transport, clock, limits=LIMITS, safe=HOLD)
    transport.unplug()
    chamber.safe_state()
    assert _is_safe(bench.device, HOLD)


def test_a_port_that_is_gone_is_a_transport_error() -> None:
    """For reads, for settings and for the safe state."""
    bench = _Bench()
    bench.chamber.prepare()
    bench.transport.unplug()
    attempts: list[Callable[[], object]] = [
        bench.chamber.read,
        lambda: bench.chamber.set_temperature(30.0),
        bench.chamber.safe_state,
    ]
    for attempt in attempts:
        with pytest.raises(TransportError, match="sim://chamber"):
            attempt()


def test_closing_changes_nothing() -> None:
    """The chamber holds what it held."""
    bench = _Bench()
    bench.chamber.prepare()
    before = bench.wire.sent
    bench.chamber.close()
    assert bench.wire.sent == before
    assert bench.device.mode == "CONSTANT"


_FAULTS = st.builds(
    EspecFault,
    kind=st.sampled_from(list(FaultKind)),
    begins_s=st.floats(0.0, 40.0),
    command=st.sampled_from(["", "TEMP", "TEMP?", "TEMP,S", "MON?", "MODE"]),
    times=st.one_of(st.none(), st.integers(1, 5)),
    delay_s=st.floats(0.0, 8.0),
)


@settings(max_examples=150)
@given(
    faults=st.lists(_FAULTS, max_size=4),
    wanted=st.lists(st.floats(-60.0, 90.0), min_size=1, max_size=4),
    found=st.floats(-60.0, 90.0),
    mode=st.sampled_from(["OFF", "STANDBY", "CONSTANT", "RUN"]),
)
def test_whatever_happens_no_setpoint_outside_the_limits_is_on_the_wire(
    faults: list[EspecFault],
    wanted: list[float],
    found: float,
    mode: Literal["OFF", "STANDBY", "CONSTANT", "RUN"],
) -> None:
    """Every operation ends in what was asked or in a named error, in bounded time; then the safe state is asked for."""
    bench = _Bench(mode=mode, setpoint_degC=round(found, 1), faults=faults)
    errors: list[DeviceError] = []
    operations = [bench.chamber.prepare, *(lambda at=at: bench.chamber.set_temperature(at) for at in wanted)]
    for operation in [*operations, bench.chamber.read, bench.chamber.safe_state]:
        began_s = bench.clock.now()
        try:
            operation()
        except DeviceError as error:
            errors.append(error)
        assert bench.clock.now() - began_s < 180.0
    assert all("sim://chamber" in str(error) or isinstance(error, SetpointOutOfLimits) for error in errors)
    setpoints = [float(value) for value in re.findall(rb"TEMP,S([-0-9.]+)\r\n", bench.wire.sent)]
    assert all(LIMITS.low_degC <= setpoint <= LIMITS.high_degC for setpoint in setpoints)
    assert bench.device.ignored_requests == 0
