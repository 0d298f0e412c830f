"""Our Julabo driver against the public third-party simulator of Julabo circulators."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator

import pytest
from julabo import simulator

from drivers.chambers import ChamberLimits, SafeState
from drivers.chambers.supervised import SupervisedChamber, Supervision
from drivers.clock import VirtualClock
from drivers.errors import DeviceTimeout
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.memory import MemoryTransport
from tests.drivers.chambers.chamber_benches import ChamberBench
from tests.drivers.chambers.shipped import julabo, simulated_julabo


class _Peer:
    """The third-party simulator as a device at the far end of a transport. It has no bath: its readings stand still."""

    def __init__(self) -> None:
        self.julabo = simulator.JulaboCF("bath")
        self._received = b""
        self._replies = b""

    def receive(self, data: bytes, now_s: float) -> None:
        """Hand it every complete line."""
        self._received += data
        while b"\r" in self._received:
            line, self._received = self._received.split(b"\r", 1)
            self._replies += self.julabo.handle_message(line + b"\r") or b""

    def transmit(self, now_s: float) -> bytes:
        """Return what it answered."""
        replies, self._replies = self._replies, b""
        return replies

    def next_transmission(self, now_s: float) -> float | None:
        """It answers at once."""
        return now_s if self._replies else None


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """The simulator logs every request."""
    before = logging.root.manager.disable
    logging.disable(logging.DEBUG)
    yield
    logging.disable(before)


def _bench(safe: SafeState = SafeState("off")) -> tuple[SupervisedChamber, _Peer]:  # noqa: B008 - frozen
    clock, peer = VirtualClock(), _Peer()
    controller = julabo(MemoryTransport(peer, clock, "sim://bath"), clock)
    return SupervisedChamber(controller, clock, Supervision(limits=ChamberLimits(10.0, 80.0), safe=safe)), peer


def test_the_captured_conversations_are_its_own() -> None:
    """VERSION and STATUS as the reference has them."""
    _, peer = _bench()
    peer.receive(b"VERSION\r", 0.0)
    assert peer.transmit(0.0) == b"JULABO CRYOCOMPACT CF31 VERSION 5.0\r\n"
    peer.receive(b"OUT_MODE_05 1\rSTATUS\r", 0.0)
    assert peer.transmit(0.0) == b"03 REMOTE START\r\n"


def test_identify_prepare_set_read_and_safe_state() -> None:
    """A whole conversation with somebody else's idea of a Julabo."""
    chamber, peer = _bench()
    assert chamber.identify().model == "JULABO CRYOCOMPACT CF31 VERSION 5.0"
    chamber.prepare()
    chamber.set_temperature(55.5)
    reading = chamber.read()
    assert (reading.temperature_degC, reading.setpoint_degC, reading.mode) == (29.45, 55.5, "CONSTANT")
    assert (reading.low_limit_degC, reading.high_limit_degC) == (5.0, 85.0)
    assert peer.julabo._config["SP_00"] == "55.5"
    chamber.safe_state()
    assert peer.julabo._config["STATUS"] == "02 REMOTE STOP"


def test_a_held_safe_state() -> None:
    """It starts the circulation at the temperature that the bench file gives."""
    chamber, peer = _bench(SafeState("hold", 20.0))
    chamber.safe_state()
    assert (peer.julabo._config["SP_00"], peer.julabo._config["MODE_05"]) == ("20.0", "1")


@pytest.mark.parametrize(("parameters", "native"), [("SP_01/02", (17.0, 85.0)), ("none", (-math.inf, math.inf))])
def test_models_without_the_usual_warning_limits_are_used_with_theirs_or_with_none(
    parameters: str, native: tuple[float, float]
) -> None:
    """Nothing is asked or written that such a model does not know; where it has none, the reading says so.

    The bath is colder than the bench's limits at first, so that a warning limit would be set around it.
    """
    bench = ChamberBench("julabo", limits=ChamberLimits(30.0, 80.0), safe=SafeState("off"), warning_limits=parameters)
    bench.chamber.prepare()
    bench.chamber.set_temperature(55.5)
    reading = bench.chamber.read()
    assert (reading.low_limit_degC, reading.high_limit_degC) == native
    assert b"SP_03" not in bench.wire.sent


def test_a_model_that_was_described_wrongly_says_what_to_write() -> None:
    """A parameter that it does not know is not answered; nothing was set."""
    bench = ChamberBench("julabo", warning_limits="none")
    with pytest.raises(DeviceTimeout, match=r"IN_SP_03.*warning_limits: SP_01/02, or none"):
        bench.rebuilt(warning_limits=None).prepare()
    assert bench.setpoints == []


def test_lower_case_is_heard_too() -> None:
    """As the manual prints requests."""
    device = simulated_julabo(ChamberPlant())
    device.receive(b"out_sp_00 55.5\rin_sp_00\r", 0.0)
    assert device.transmit(1.0) == b"55.5\n"
