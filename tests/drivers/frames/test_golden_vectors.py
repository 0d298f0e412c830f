"""Every published vector of a chamber controller, byte for byte and in both directions, or why that cannot be."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.clock import VirtualClock
from drivers.simulators import SimulatedDevice
from drivers.simulators.memory import MemoryTransport
from tests.drivers.chambers.golden_modbus import MODBUS
from tests.drivers.chambers.golden_text import TEXT
from tests.drivers.frames.golden_vectors import GoldenWire, Key, Vector
from tests.drivers.transcript import TranscriptDevice

VECTORS: dict[Key, Vector] = {**TEXT, **MODBUS}
ANSWERED = [key for key, vector in VECTORS.items() if not isinstance(vector.simulator, str)]
SENT = [key for key, vector in VECTORS.items() if not isinstance(vector.driver, str)]

# Every vector that does not pass in some direction: the reason itself stands with the vector.
NOT_ANSWERED = {
    ("thermotron8800", "aux_op"),
    ("thermotron8800", "alarm"),
    ("julabo", "version"),
    ("julabo", "status"),
    ("weiss_stx", "read"),
    ("weiss_stx", "stop"),
}
NOT_SENT = {
    ("espec", "humi"),
    ("espec", "set"),
    ("espec", "cmd_err"),
    ("espec", "const"),
    ("voetsch_ascii", "write_as_printed_15bits"),
    ("voetsch_ascii", "gradient"),
    ("voetsch_ascii", "quit"),
    ("voetsch_ascii", "prog7"),
    ("thermotron8800", "aux_op"),
    ("thermotron8800", "alarm"),
    ("weiss_stx", "read"),
    ("watlow_any", "exc01"),
}


def test_the_vectors_are_all_of_the_reference_and_its_bytes(reference: Path) -> None:
    """A vector that nobody here knows fails, and so does one that was copied wrongly.

    Kept as they are printed: the 15 bits of an ASCII-2 write, and its error 01, whose text belongs to error 02.
    """
    vectors = json.loads((reference / "chambers_golden.json").read_text(encoding="utf-8"))
    expected = {
        (vector["controller"], vector["name"]): (vector["tx_hex"], vector["rx_hex"] or "") for vector in vectors
    }
    assert {key: (vector.request.hex(), vector.reply.hex()) for key, vector in VECTORS.items()} == expected
    assert len(expected) == len(vectors)


def test_what_does_not_pass_is_known_and_has_its_reason() -> None:
    """Nobody can take a vector out of the proof without saying so here."""
    assert set(VECTORS) - set(ANSWERED) == NOT_ANSWERED
    assert set(VECTORS) - set(SENT) == NOT_SENT
    for vector in VECTORS.values():
        for reason in (vector.simulator, vector.driver):
            assert not isinstance(reason, str) or len(reason.split()) > 4


@pytest.mark.parametrize("key", ANSWERED, ids="-".join)
def test_the_simulator_gives_the_published_reply(key: Key) -> None:
    """Byte for byte, terminator or checksum included; nothing where the source shows none."""
    vector = VECTORS[key]
    assert not isinstance(vector.simulator, str)
    device = vector.simulator()
    device.receive(vector.request, 0.0)
    assert device.transmit(0.0) == vector.reply
    assert device.transmit(100.0) == b""


@pytest.mark.parametrize("key", SENT, ids="-".join)
def test_the_driver_sends_the_published_request_and_understands_the_reply(key: Key) -> None:
    """The request goes over the wire literally, and is answered from the book; what it is taken for is checked."""
    vector = VECTORS[key]
    assert not isinstance(vector.driver, str)
    wire = GoldenWire(_simulator(key)(), vector.request, vector.reply)
    clock = VirtualClock()
    vector.driver(MemoryTransport(wire, clock, "sim://chamber"), clock)
    assert wire.seen == 1
    assert wire.next_transmission(clock.now()) is None


def _simulator(key: Key) -> Callable[[], SimulatedDevice]:
    """Return what answers everything but the published request: its own simulator, or one of the same controller."""
    for candidate in (key, *(other for other in ANSWERED if other[0] == key[0])):
        simulator = VECTORS[candidate].simulator
        if not isinstance(simulator, str):
            return simulator
    return lambda: TranscriptDevice([])  # whatever else is sent fails
