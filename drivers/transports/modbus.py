"""Modbus registers over a `Transport`: pymodbus makes and reads the frames, deadlines and pauses are ours.

pymodbus' own client opens its own port and looks at the computer's clock, so only its framers and PDUs are used: frame
layout, CRC and transaction numbers are not written a second time. `rtu` is also what a serial device server carries
over TCP (`socket://`); `tcp` is Modbus TCP with its header.

An RTU reply does not say which request it answers. One that comes late could answer the next request of the same
shape: after a request without an answer the line is listened to for `late_s` before anything else is sent, so that a
reply up to `timeout_s + late_s` late is never taken for another. Modbus TCP has transaction numbers and needs no wait.
"""

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsRequest, ReadDiscreteInputsRequest, WriteSingleCoilRequest
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError, TransportError, worded
from drivers.transports.transport import Reply, Timing, Transport, asked

Framing = Literal["rtu", "tcp"]
Table = Literal["holding", "input", "coil", "discrete"]
NumberType = Literal["int16", "uint16", "int32", "uint32", "float32"]

_READS: Mapping[Table, type[ModbusPDU]] = {
    "holding": ReadHoldingRegistersRequest,
    "input": ReadInputRegistersRequest,
    "coil": ReadCoilsRequest,
    "discrete": ReadDiscreteInputsRequest,
}
_FORMATS: Mapping[NumberType, str] = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
_MEANINGS = {
    1: "it does not know this function: check that the bench file names the right controller",
    2: "it has no such register: check that the bench file names the right controller",
    3: "the value is not allowed there: check the limits set at its panel",
    4: "it failed: look for a message on its panel",
    6: "it is busy: wait, and try again",
}


def framer_of(framing: Framing, *, of_unit: bool = False) -> FramerBase:
    """Return what makes and reads frames, on the side of the host or of the unit."""
    decoder = DecodePDU(of_unit)
    return FramerRTU(decoder) if framing == "rtu" else FramerSocket(decoder)


@dataclass(eq=False)
class ModbusExchange:
    """Reads and writes the registers and coils of one unit. `device` begins every message."""

    transport: Transport
    clock: Clock
    _: KW_ONLY
    device: str
    unit: int = 1
    framing: Framing = "rtu"
    # The pause after a query follows every exchange.
    timing: Timing = Timing(1.0, 0.03, late_s=4.0)  # noqa: RUF009 - frozen
    _ready_at_s = -math.inf
    _unanswered = False
    _transaction = 0

    def __post_init__(self) -> None:
        self._framer = framer_of(self.framing)

    def query(self, address: int, count: int, parse: Callable[[list[int]], Reply], table: Table = "holding") -> Reply:
        """Return what `parse` makes of `count` registers (or coils: 0 or 1) from `address` on, unsigned numbers.

        Asked until it accepts them, at most `ATTEMPTS` times; raises the last error: `DeviceTimeout`, `ProtocolError`,
        `CommandRefused` for an exception reply, or `TransportError`.
        """
        return asked(lambda: parse(self._read_once(address, count, table)))

    def write(self, address: int, *values: int, several: bool = False) -> bool:
        """Send registers once (one by function 6 unless `several`, else 16); return whether they were acknowledged.

        False means that nobody knows whether it was carried out: read back. Negative values are two's complement.
        Raises `CommandRefused` for an exception reply, `TransportError` where unsent, `ValueError` beyond 16 bits.
        """
        kind = WriteMultipleRegistersRequest if several or len(values) > 1 else WriteSingleRegisterRequest
        return self._write(kind(address=address, registers=list(map(_register, values)), dev_id=self.unit))

    def write_coil(self, address: int, *, on: bool) -> bool:
        """Switch one coil (function 5) once; returns and raises (`CommandRefused`) as `write`."""
        return self._write(WriteSingleCoilRequest(address=address, bits=[on], dev_id=self.unit))

    def _read_once(self, address: int, count: int, table: Table) -> list[int]:
        bits = table in ("coil", "discrete")
        what = f"{'coils' if bits else 'registers'} {address} to {address + count - 1}"
        reply = self._exchange(_READS[table](address=address, count=count, dev_id=self.unit), what)
        found = [int(bit) for bit in reply.bits] if bits else list(reply.registers)
        if len(found) != (8 * -(-count // 8) if bits else count):  # bits fill their last byte
            raise ProtocolError(
                f"{self.device} sent {len(found)} where {count} from {address} on were asked for; check that only one "
                "program talks to it"
            )
        return found[:count]

    def _write(self, request: ModbusPDU) -> bool:
        try:
            reply = self._exchange(request, f"a write of register {request.address}", written=True)
        except (DeviceTimeout, ProtocolError):
            return False
        return reply.address == request.address

    def _exchange(self, request: ModbusPDU, what: str, *, written: bool = False) -> ModbusPDU:
        if self.framing == "tcp":
            self._transaction = self._transaction % 0xFFFF + 1
        request.transaction_id = self._transaction
        frame = self._framer.buildFrame(request)
        self._wait_for_quiet()
        self.transport.write(frame)
        self._unanswered = True
        try:
            reply = self._receive(frame, request, what)
        except TransportError:
            if written:
                raise DeviceTimeout(f"{self.device}: the port failed after {what} was sent") from None
            raise
        except ProtocolError:
            self._unanswered = False  # damaged, but it was the answer
            raise
        finally:
            self._ready_at_s = self.clock.now() + self.timing.pause_after_query_s
        self._unanswered = False
        if reply.isError():
            code = reply.exception_code
            meaning = _MEANINGS.get(code, "look up the code in its manual")
            raise CommandRefused(f"{self.device} refused {what} with exception {code}: {meaning}")
        return reply

    def _wait_for_quiet(self) -> None:
        """Keep the pause; after a request without an answer, let a late one come and throw it away."""
        self.clock.sleep(self._ready_at_s - self.clock.now())
        if self._unanswered and self.framing == "rtu":
            until_s = self.clock.now() + self.timing.late_s
            while (left_s := until_s - self.clock.now()) > 0.0:
                if self.transport.read(1, left_s):
                    self.clock.sleep(min(self.timing.pause_after_query_s, left_s))  # the rest of that reply
                    break
        self._unanswered = False
        self.transport.read_available()

    def _receive(self, frame: bytes, request: ModbusPDU, what: str) -> ModbusPDU:
        deadline_s = self.clock.now() + self.timing.timeout_s
        arrived = b""
        while True:
            remaining_s = deadline_s - self.clock.now()
            more = self.transport.read(1, max(remaining_s, 0.0)) + self.transport.read_available()
            if not more:
                raise DeviceTimeout(
                    f"{self.device} did not answer {what} in {self.timing.timeout_s:g} s; check its power, the "
                    f"cable, its address ({self.unit}), baud rate and parity"
                    + (f" (what arrived: {arrived.hex(' ')})" if arrived else "")
                )
            arrived += more
            if len(arrived) > self._framer.MAX_SIZE:
                raise ProtocolError(f"{self.device} sent noise; check baud rate, parity and the cable")
            if self.framing == "rtu" and isinstance(request, tuple(_READS.values())) and arrived.startswith(frame):
                arrived = arrived[len(frame) :]  # a two-wire adapter hears itself
            begin, unread = f"{self.device} answered {what} with {arrived.hex(' ')}: ", (struct.error, IndexError)
            with worded(ProtocolError, begin, (ModbusException, ValueError, *unread)):
                arrived, reply = self._decode(arrived)
            # Another unit's, or an earlier transaction's, is passed over.
            ours = self.unit, request.function_code, request.transaction_id
            if reply is not None and (reply.dev_id, reply.function_code & 0x7F, reply.transaction_id) == ours:
                return reply

    def _decode(self, arrived: bytes) -> tuple[bytes, ModbusPDU | None]:
        """Return what is left and the first whole frame; None where it is not whole yet."""
        if len(arrived) < self._framer.MIN_SIZE:
            return arrived, None
        used, reply = self._framer.handleFrame(arrived, 0, 0)
        if used and reply is None:
            raise ProtocolError(
                f"{self.device} sent a frame with a wrong checksum ({arrived.hex(' ')}); check the cable, its shield "
                "and the baud rate"
            )
        return arrived[used:], reply


def _register(value: int) -> int:
    if not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"{value} does not fit into a 16-bit register; nothing was sent")
    return value & 0xFFFF


def encoded(value: float, kind: NumberType, *, scale: float = 1.0, low_word_first: bool = True) -> tuple[int, ...]:
    """Return the one or two registers that hold `value` in units of `scale`; `ValueError` where none can."""
    form = _FORMATS[kind]
    try:
        # int() would make 1000 of 100.1
        data = struct.pack(f">{form}", value / scale if form == "f" else round(value / scale))
    except (struct.error, OverflowError, ValueError):
        raise ValueError(f"{value:g} in units of {scale:g} does not fit into {kind}; nothing was sent") from None
    words = struct.unpack(f">{len(data) // 2}H", data)
    return words[::-1] if low_word_first else words


def decoded(registers: Sequence[int], kind: NumberType, *, scale: float = 1.0, low_word_first: bool = True) -> float:
    """Return the number that registers hold in units of `scale`, whole where both are."""
    words = registers[::-1] if low_word_first else registers
    raw: float = struct.unpack(f">{_FORMATS[kind]}", struct.pack(f">{len(words)}H", *words))[0]
    return raw if scale == 1.0 else round(raw * scale, 6)


def width(kind: NumberType) -> int:
    """Return how many registers hold a number."""
    return struct.calcsize(f">{_FORMATS[kind]}") // 2
