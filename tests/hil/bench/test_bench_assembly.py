"""A bench is put together from its file, refuses what cannot be, and leaves nothing open."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from drivers.clock import Clock, SystemClock, VirtualClock
from drivers.errors import DeviceTimeout, SetpointOutOfLimits, TransportError, WrongDevice
from drivers.positioners.indexing import IndexingPositioner
from drivers.positioners.positioner import OperatorPositioner
from drivers.simulators.memory import MemoryTransport
from drivers.transports import Transport
from hil.bench import build_bench
from hil.config import Bench, load_bench, parse_bench
from hil.errors import InputError
from hil.twin.motion import Resumed

_TEXT = load_bench("simulated").text


def _bench(*changes: tuple[str, str]) -> Bench:
    text = _TEXT
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return parse_bench(text, "my-bench.yaml")


def _real(imu: str, chamber: str) -> Bench:
    return _bench(("clock: virtual", "clock: system"), ("sim://imu", imu), ("sim://chamber", chamber))


def test_the_simulated_bench_answers_through_the_production_drivers() -> None:
    """Identity, chamber and position, by the same bytes as on a wire."""
    with build_bench(load_bench("simulated")) as live:
        devices = live.devices
        identity = devices.imu.identify()
        assert (identity.model, identity.serial, identity.firmware) == ("MFS-IMU", "SIM-0001", "simulated")
        assert "SIMULATED" in devices.chamber.identify().model
        assert isinstance(devices.clock, VirtualClock)
        assert isinstance(devices.positioner, IndexingPositioner)
        assert set(devices.imu.sensors) == {1, 2}
        devices.positioner.move_to("2", timeout_s=60.0)
        assert devices.positioner.position() == "2"
        assert live.bench.simulated


@pytest.mark.slow
def test_the_chamber_and_the_unit_share_one_air() -> None:
    """The controller's setpoint reaches the unit's own thermometer."""
    with build_bench(load_bench("simulated")) as live:
        live.devices.chamber.prepare()
        live.devices.chamber.set_temperature(-20.0)
        live.devices.clock.sleep(4 * 3600.0)
        assert live.devices.chamber.read().temperature_degC == pytest.approx(-20.0, abs=0.2)
        assert live.devices.imu.read_block().fields["rotor_2_degC"][-1] == pytest.approx(-20.0, abs=0.2)


def test_a_night_that_is_carried_on_goes_on_in_time_with_a_chamber_that_nobody_controlled() -> None:
    """The virtual clock begins where it is told, the chamber at the room's temperature and switched off."""
    began = datetime(1985, 10, 2, 3, 0, tzinfo=UTC)
    with build_bench(load_bench("simulated"), start_utc=began, resumed=Resumed(4, session=1)) as live:
        assert live.devices.clock.utc() == began
        reading = live.devices.chamber.read()
        assert (reading.temperature_degC, reading.mode) == (23.0, "OFF")


@pytest.mark.parametrize("key", ["imu", "chamber"])
def test_a_port_that_does_not_exist_is_bad_input(key: str, tmp_path: Path) -> None:
    """Before anything is opened: the sentence names file, key and port."""
    there, nowhere = tmp_path / "there", tmp_path / "ttyUSB7"
    there.touch()
    bench = _real(*(str(nowhere if key == name else there) for name in ("imu", "chamber")))
    with pytest.raises(InputError, match=rf"my-bench\.yaml: {key}\.port: {nowhere}: there is no such port"):
        build_bench(bench)


def test_a_port_that_cannot_be_opened_leaves_nothing_open(tmp_path: Path) -> None:
    """A file is no port: pyserial says so, in the driver's words."""
    no_port = tmp_path / "file"
    no_port.touch()
    with pytest.raises(TransportError):
        build_bench(_real(str(no_port), str(no_port)))


def _silence(question: str, timeout_s: float) -> bool | None:
    """An operator who went home."""
    return None


def test_an_operators_bench_needs_somebody_to_ask() -> None:
    """With somebody there, the positioner is the operator."""
    bench = _bench(("positioner: indexing", "positioner: operator"))
    with pytest.raises(InputError, match="none is there to ask"):
        build_bench(bench)
    with build_bench(bench, ask=_silence) as live:
        assert isinstance(live.devices.positioner, OperatorPositioner)
        with pytest.raises(DeviceTimeout):
            live.devices.positioner.move_to("1", timeout_s=1.0)


def test_simulated_devices_also_run_under_the_computers_clock() -> None:
    """The clock is the bench file's; the devices cannot tell."""
    with build_bench(_bench(("clock: virtual", "clock: system"))) as live:
        assert isinstance(live.devices.clock, SystemClock)
        assert live.devices.imu.identify().model == "MFS-IMU"


def test_every_setting_of_the_chamber_section_reaches_the_driver() -> None:
    """Address, line end, limits, margin and safe state, seen from the controller's side."""
    bench = _bench(
        ("  model: P300    ", "  address: 2\n  terminator: CR\n  native_margin: 3 degC\n  model: P300    "),
        ("{action: standby}", "{action: hold, temperature: 30 degC}"),
    )
    with build_bench(bench) as live:
        chamber = live.devices.chamber
        chamber.prepare()
        reading = chamber.read()
        assert (reading.low_limit_degC, reading.high_limit_degC) == (-48.0, 78.0)
        with pytest.raises(SetpointOutOfLimits):
            chamber.set_temperature(76.0)
        chamber.safe_state()
        reading = chamber.read()
        assert (reading.mode, reading.setpoint_degC) == ("CONSTANT", 30.0)


def test_another_chamber_on_the_port_is_refused() -> None:
    """The model of the bench file is how its answer begins."""
    with (
        build_bench(_bench(("  model: P300    ", "  model: SH-641  "))) as live,
        pytest.raises(WrongDevice, match="SH-641"),
    ):
        live.devices.chamber.identify()


def test_the_rate_of_the_bench_file_takes_the_place_of_the_descriptions() -> None:
    """The simulated unit streams at it, and the driver knows."""
    with build_bench(_bench(("  port: sim://imu", "  rate: 50 Hz\n  port: sim://imu"))) as live:
        assert live.devices.imu.sample_rate_hz == 50.0
        live.devices.imu.discard()
        live.devices.clock.sleep(10.0)
        assert len(live.devices.imu.read_block()) == 500


def test_real_ports_are_opened_with_their_own_baud_rates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bench file's, or else the frame description's."""
    opened = []

    def refuse(url: str, *, clock: Clock, baudrate: int, **_line: object) -> Transport:
        opened.append((Path(url).name, baudrate))
        if len(opened) == 2:
            raise TransportError("enough seen")
        return MemoryTransport(_Nothing(), clock, url)

    monkeypatch.setattr("hil.bench.assemble.open_port", refuse)
    for name in ("imu", "chamber"):
        (tmp_path / name).touch()
    with pytest.raises(TransportError, match="enough seen"):
        build_bench(_real(str(tmp_path / "imu"), str(tmp_path / "chamber")))
    assert opened == [("imu", 115200), ("chamber", 19200)]


class _Nothing:
    """A device that never says anything."""

    def receive(self, data: bytes, now_s: float) -> None: ...

    def transmit(self, now_s: float) -> bytes:
        return b""

    def next_transmission(self, now_s: float) -> float | None:
        return None


def test_the_simulated_chamber_cools_as_slowly_as_its_section_says() -> None:
    """Heating and cooling each at their own rate: half an hour of ramp at 2 and 1 °C/min."""
    bench = _bench(("{heating: 3 degC/min, cooling: 3 degC/min}", "{heating: 2 degC/min, cooling: 1 degC/min}"))
    with build_bench(bench) as live:
        live.devices.chamber.prepare()
        for setpoint, moved in ((70.0, 20.0), (-40.0, -10.0)):
            before = live.devices.chamber.read().temperature_degC
            live.devices.chamber.set_temperature(setpoint)
            live.devices.clock.sleep(600.0)
            assert live.devices.chamber.read().temperature_degC - before == pytest.approx(moved, abs=1.5)


def test_closing_twice_is_allowed() -> None:
    """A bench that is left by an exception may have been closed before."""
    with build_bench(load_bench("simulated")) as live:
        live.close()
    live.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ('position: "3"', 'position: "9"'),
            r"simulation\.start\.position: there is no position '9'; allowed: 1, 2, 3, 4",
        ),
        (
            ("channels: {RA: A, RB: B}      # RA", "channels: {RX: A, RB: B}      # RA"),
            "sensors.2: the IMU description mfs has no channel RX",
        ),
        (("\n  2:\n    axes", "\n  7:\n    axes"), "does not say which fields are the rates of sensor"),
    ],
)
def test_a_simulation_that_does_not_go_together_is_bad_input(change: tuple[str, str], message: str) -> None:
    """Bench file, frame description and model each say something about the same sensors."""
    with pytest.raises(InputError, match=message):
        build_bench(_bench(change))


def test_faults_of_the_bench_file_happen_to_the_devices() -> None:
    """A stream that stalls from the tenth second on, and a chamber that raises an alarm."""
    faults = "  imu_faults: [{fault: stall, begins: 10 s}]\n  chamber_faults: [{kind: alarm, begins: 10 s}]\n"
    with build_bench(parse_bench(_TEXT + faults, "b")) as live:
        live.devices.clock.sleep(20.0)
        block = live.devices.imu.read_block()
        assert len(block) == 200
        assert live.devices.chamber.read().alarms == ("alarm 19",)
