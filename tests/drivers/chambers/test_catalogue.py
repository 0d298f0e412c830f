"""What a bench file says of a chamber's line reaches the driver and the simulator that it names."""

from __future__ import annotations

from drivers.chambers import CHAMBER_DRIVERS, ChamberLimits, ChamberOptions, SafeState
from drivers.clock import VirtualClock
from drivers.simulators.chambers.catalogue import CHAMBER_SIMULATORS, SimulatorOptions
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from tests.drivers.transcript import TranscriptDevice

OPTIONS = ChamberOptions(ChamberLimits(-40.0, 80.0), SafeState("off"), celsius_confirmed=True, terminator="LF")


def test_a_terminator_ends_what_the_driver_sends() -> None:
    """And its own ends it where the file says nothing."""
    for options, end in (
        (OPTIONS, b"\n"),
        (ChamberOptions(OPTIONS.limits, OPTIONS.safe, celsius_confirmed=True), b"\r"),
    ):
        clock = VirtualClock()
        device = TranscriptDevice([(b"IDEN?" + end, b"TT 8800" + end)])
        transport = MemoryTransport(device, clock, "sim://chamber")
        assert CHAMBER_DRIVERS["thermotron"].build(transport, clock, options).identify().model == "TT 8800"
        device.finish()


def test_a_terminator_ends_what_the_simulator_takes_and_sends() -> None:
    """Byte for byte."""
    device = CHAMBER_SIMULATORS["thermotron"](ChamberPlant(), SimulatorOptions(terminator="LF"))
    device.receive(b"IDEN?\n", 0.0)
    assert device.transmit(1.0) == b"8800 SIMULATED\n"
