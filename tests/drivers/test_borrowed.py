"""Devices of other libraries as chamber and positioner: the real libraries where they are installed."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.borrowed import Value, awaited
from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.controllers.borrowed import BorrowedController
from drivers.chambers.controllers.description import load_box
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import SystemClock, VirtualClock
from drivers.errors import DeviceError, DeviceTimeout, ProtocolError, SetpointOutOfLimits, TransportError
from drivers.positioners.borrowed import BorrowedPositioner
from drivers.simulators.chambers.described import simulated_box
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from drivers.transports.transport import own_port
from tests.drivers.chambers.chamber_benches import EXAMPLE_BOX


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_pymeasures_temptronic_is_a_chamber() -> None:
    """Its own class against our simulated box: set and read back, bounded by our limits, left as the bench says."""
    adapters = pytest.importorskip("pymeasure.adapters", reason="pymeasure is not installed")
    temptronic = pytest.importorskip("pymeasure.instruments.temptronic")
    clock, device = VirtualClock(), simulated_box(ChamberPlant(), load_box(EXAMPLE_BOX))
    wire = MemoryTransport(device, clock, "sim://ats")

    class Wire(adapters.Adapter):  # type: ignore[misc]
        def _write(self, command: str, **_: Any) -> None:
            wire.write(f"{command}\n".encode())

        def _read(self, **_: Any) -> str:
            return wire.read_until(b"\n", 2.0).decode().strip()

    ats = temptronic.ATS545(Wire())
    controller = BorrowedController(
        own_port("own://ats", clock), Value(ats, "temperature"), Value(ats, "temperature_setpoint"), model="ATS545"
    )
    chamber = SupervisedChamber(
        controller,
        clock,
        Supervision(limits=ChamberLimits(-20.0, 60.0), safe=SafeState("hold", 25.0), celsius_confirmed=True),
    )
    device.mode = "CONSTANT"
    chamber.prepare()
    chamber.set_temperature(42.0)
    clock.sleep(3600.0)
    assert device.setpoint_degC == 42.0
    assert chamber.read().temperature_degC == pytest.approx(42.0, abs=0.2)
    with pytest.raises(SetpointOutOfLimits):
        chamber.set_temperature(61.0)
    chamber.safe_state()
    assert device.setpoint_degC == 25.0


class _Plain:
    """A device with attributes; it holds what it is set to, or stays where it is."""

    def __init__(self, *, stuck: bool = False) -> None:
        self.stuck, self.running, self.temperature, self._setpoint = stuck, False, 21.0, 20.0

    @property
    def setpoint(self) -> float:
        return self._setpoint

    @setpoint.setter
    def setpoint(self, value: float) -> None:
        if value > 100.0:
            raise RuntimeError("no")
        self._setpoint = self._setpoint if self.stuck else value


def _chamber(device: _Plain) -> SupervisedChamber:
    clock = VirtualClock()
    values = Value(device, "temperature"), Value(device, "setpoint")
    controller = BorrowedController(
        own_port("own://oven", clock), *values, model="Oven", unit="degC", running=Value(device, "running")
    )
    return SupervisedChamber(controller, clock, Supervision(limits=ChamberLimits(-20.0, 160.0), safe=SafeState("off")))


def test_a_borrowed_chamber_is_read_back_and_switched() -> None:
    """One that does not take what it is told is refused; what its library raises is told with the value's name."""
    device = _Plain()
    chamber = _chamber(device)
    chamber.prepare()
    chamber.set_temperature(30.0)
    assert (device.setpoint, device.running) == (30.0, True)
    with pytest.raises(DeviceError, match=r"_Plain setpoint: cannot be set to 120.0: RuntimeError: no"):
        chamber.set_temperature(120.0)
    chamber.safe_state()
    assert device.running is False
    with pytest.raises(ProtocolError, match="own://oven reads back setpoint 20 °C instead of 21 °C"):
        _chamber(_Plain(stuck=True)).prepare()
    with pytest.raises(TransportError, match="own://oven: only a driver that opens its device itself"):
        own_port("own://oven", VirtualClock()).write(b"?")


def test_an_ophyd_axis_is_a_positioner() -> None:
    """Set, waited for, and read."""
    sim = pytest.importorskip("ophyd.sim", reason="ophyd is not installed; pip install ophyd")
    motor = sim.SynAxis(name="table")
    table = BorrowedPositioner(SystemClock(), {"1": 0.0, "2": 90.0}, Value(motor), Value(motor, "readback"))
    assert table.position() == "1"
    table.move_to("2", 10.0)
    assert (table.position(), motor.readback.get()) == ("2", 90.0)


def test_an_ophyd_async_motor_and_signal_are_positioner_and_setpoint() -> None:
    """In an event loop of their own; a motor that is too slow is a time-out, and is stopped."""
    why = "ophyd-async is not installed; pip install ophyd-async"
    core, sim = (pytest.importorskip(f"ophyd_async.{name}", reason=why) for name in ("core", "sim"))

    async def made() -> tuple[Any, Any]:
        async with core.init_devices():
            motor, setpoint = sim.SimMotor(name="table", instant=False), core.soft_signal_rw(float, 20.0, "setpoint")
        await motor.velocity.set(900.0)
        return motor, setpoint

    motor, setpoint = awaited(made(), 10.0)
    value = Value(setpoint)
    value.put(33.0)
    assert value.get() == 33.0
    stopped = []
    table = BorrowedPositioner(
        SystemClock(),
        {"1": 0.0, "2": 90.0, "3": 36_000.0},
        Value(motor),
        Value(motor, "user_readback"),
        stop=lambda: stopped.append(awaited(motor.stop(), 10.0)),
    )
    table.move_to("2", 10.0)
    assert table.position() == "2"
    with pytest.raises(DeviceTimeout, match=r"SimMotor table: not set to 36000.0 within 0.3 s"):
        table.move_to("3", 0.3)
    assert len(stopped) == 1


def test_a_table_that_never_gets_there_is_given_up_and_stopped() -> None:
    """In the time it is given; whole turns are no difference."""
    clock, device, stopped = VirtualClock(), _Plain(), []
    angle = Value(device, "temperature")
    table = BorrowedPositioner(
        clock, {"1": 381.0, "2": 90.0}, Value(device, "setpoint"), angle, stop=lambda: stopped.append(clock.now())
    )
    assert table.position() == "1"
    with pytest.raises(DeviceTimeout, match="not in position 2 after 10 s"):
        table.move_to("2", 10.0)
    assert stopped == [pytest.approx(10.0, abs=0.2)]
