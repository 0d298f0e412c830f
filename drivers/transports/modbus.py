"""Modbus registers over a `Transport`: pymodbus makes and reads the frames, deadlines and pauses are ours.

    exchange = ModbusExchange(transport, clock, device="chamber on /dev/ttyUSB0", unit=1, framing="rtu")
    exchange.read(100, 1)                 # 01 03 00 64 00 01 C5 D5 -> [253]

pymodbus' own client opens its own port and looks at the computer's clock, so only its framers and PDUs are used: frame
layout, CRC and transaction numbers are not written a second time. `rtu` is also what a serial device server carries
over TCP (`socket://`); `tcp` is Modbus TCP with its header.

An RTU reply does not say which request it answers. One that comes late could answer the next request of the same
shape: after a request without an answer the line is listened to for `late_s` before anything else is sent, so that a
reply up to `timeout_s + late_s` late is never taken for another. Modbus TCP has transaction numbers and needs no wait.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError, TransportError
from drivers.transports.asking import Reply, asked
from drivers.transports.transport import Transport

Framing = Literal["rtu", "tcp"]

_MEANINGS = {
    1: "it does not know this function: check that the bench file names the right controller",
    2: "it has no such register: check that the bench file names the right controller",
    3: "the value is not allowed there: check the limits set at its panel",
    4: "it failed: look for a message on its panel",
    6: "it is busy: wait, and try again",
}


@dataclass(frozen=True)
class ModbusTiming:
    """How a controller wants to be spoken to, seconds; `attempts` counts the first asking of a read."""

    timeout_s: float = 1.0
    pause_s: float = 0.03  # after every exchange
    late_s: float = 4.0
    attempts: int = 3


class ModbusExchange:
    """Reads and writes the holding registers of one unit. `device` begins every message."""

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        device: str,
        unit: int = 1,
        framing: Framing = "rtu",
        timing: ModbusTiming | None = None,
    ) -> None:
        decoder = DecodePDU(False)
        self._framer: FramerBase = FramerRTU(decoder) if framing == "rtu" else FramerSocket(decoder)
        self._framing = framing
        self._transport = transport
        self._clock = clock
        self._device = device
        self._unit = unit
        self._timing = timing or ModbusTiming()
        self._ready_at_s = clock.now()
        self._unanswered = False
        self._transaction = 0

    def read(self, address: int, count: int) -> list[int]:
        """Return `count` registers from `address` on, as unsigned numbers.

        Asked at most `attempts` times; raises the last error: `DeviceTimeout`, `ProtocolError`, `CommandRefused` for
        an exception reply, or `TransportError`.
        """
        return self.query(address, count, lambda registers: registers)

    def query(self, address: int, count: int, parse: Callable[[list[int]], Reply]) -> Reply:
        """Read registers until `parse` accepts them; raises as `read` does."""
        return asked(lambda: parse(self._read_once(address, count)), self._timing.attempts)

    def write(self, address: int, value: int) -> bool:
        """Send one register (function 6) once; return whether it was acknowledged.

        False means that nobody knows whether it was carried out: read back. Raises `CommandRefused` for an exception
        reply, `TransportError` where it could not be sent, and `ValueError` for what no 16-bit register holds. Negative
        values are two's complement.
        """
        return self._write(WriteSingleRegisterRequest(address=address, registers=[_register(value)], dev_id=self._unit))

    def write_several(self, address: int, values: Sequence[int]) -> bool:
        """Send several registers (function 16) once; returns and raises (`CommandRefused`, `ValueError`) as `write`."""
        registers = [_register(value) for value in values]
        return self._write(WriteMultipleRegistersRequest(address=address, registers=registers, dev_id=self._unit))

    def _read_once(self, address: int, count: int) -> list[int]:
        request = ReadHoldingRegistersRequest(address=address, count=count, dev_id=self._unit)
        reply = self._exchange(request, f"registers {address} to {address + count - 1}")
        if len(reply.registers) != count:
            raise ProtocolError(
                f"{self._device} sent {len(reply.registers)} registers where {count} from {address} on were asked for; "
                "check that only one program talks to it"
            )
        return list(reply.registers)

    def _write(self, request: ModbusPDU) -> bool:
        try:
            reply = self._exchange(request, f"a write of register {request.address}", written=True)
        except (DeviceTimeout, ProtocolError):
            return False
        return reply.address == request.address

    def _exchange(self, request: ModbusPDU, what: str, *, written: bool = False) -> ModbusPDU:
        """Send one request and return the reply to it, of the same function."""
        if self._framing == "tcp":
            self._transaction = self._transaction % 0xFFFF + 1
        request.transaction_id = self._transaction
        frame = self._framer.buildFrame(request)
        self._wait_for_quiet()
        self._transport.write(frame)
        self._unanswered = True
        try:
            reply = self._receive(frame, request, what)
        except TransportError:
            if written:
                raise DeviceTimeout(f"{self._device}: the port failed after {what} was sent") from None
            raise
        except ProtocolError:
            self._unanswered = False  # damaged, but it was the answer
            raise
        finally:
            self._ready_at_s = self._clock.now() + self._timing.pause_s
        self._unanswered = False
        if reply.isError():
            code = reply.exception_code
            meaning = _MEANINGS.get(code, "look up the code in its manual")
            raise CommandRefused(f"{self._device} refused {what} with exception {code}: {meaning}")
        return reply

    def _wait_for_quiet(self) -> None:
        """Keep the pause; after a request without an answer, let a late one come and throw it away."""
        self._clock.sleep(self._ready_at_s - self._clock.now())
        if self._unanswered and self._framing == "rtu":
            until_s = self._clock.now() + self._timing.late_s
            while (left_s := until_s - self._clock.now()) > 0.0:
                if self._transport.read(1, left_s):
                    self._clock.sleep(min(self._timing.pause_s, left_s))  # the rest of that reply
                    break
        self._unanswered = False
        self._transport.drain()

    def _receive(self, frame: bytes, request: ModbusPDU, what: str) -> ModbusPDU:
        deadline_s = self._clock.now() + self._timing.timeout_s
        arrived = b""
        while True:
            remaining_s = deadline_s - self._clock.now()
            more = self._transport.read(1, max(remaining_s, 0.0)) + self._transport.read_available()
            if not more:
                raise DeviceTimeout(
                    f"{self._device} did not answer {what} in {self._timing.timeout_s:g} s; check its power, the "
                    f"cable, its address ({self._unit}), baud rate and parity"
                    + (f" (what arrived: {arrived.hex(' ')})" if arrived else "")
                )
            arrived += more
            if len(arrived) > self._framer.MAX_SIZE:
                raise ProtocolError(f"{self._device} sent noise; check baud rate, parity and the cable")
            if (
                self._framing == "rtu"
                and isinstance(request, ReadHoldingRegistersRequest)
                and arrived.startswith(frame)
            ):
                arrived = arrived[len(frame) :]  # a two-wire adapter hears itself
            try:
                arrived, reply = self._decode(arrived)
            except (ModbusException, struct.error, IndexError, ValueError) as error:
                raise ProtocolError(f"{self._device} answered {what} with {arrived.hex(' ')}: {error}") from error
            if reply is not None and self._answers(reply, request):
                return reply

    def _decode(self, arrived: bytes) -> tuple[bytes, ModbusPDU | None]:
        """Return what is left and the first whole frame; None where it is not whole yet."""
        if len(arrived) < self._framer.MIN_SIZE:
            return arrived, None
        used, reply = self._framer.handleFrame(arrived, 0, 0)
        if used and reply is None:
            raise ProtocolError(
                f"{self._device} sent a frame with a wrong checksum ({arrived.hex(' ')}); check the cable, its shield "
                "and the baud rate"
            )
        return arrived[used:], reply

    def _answers(self, reply: ModbusPDU, request: ModbusPDU) -> bool:
        """Say whether a frame belongs to our request; another unit's, or an earlier transaction's, is passed over."""
        same_function = reply.function_code & 0x7F == request.function_code
        return reply.dev_id == self._unit and same_function and reply.transaction_id == request.transaction_id


def _register(value: int) -> int:
    if not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"{value} does not fit into a 16-bit register; nothing was sent")
    return value & 0xFFFF


def signed(register: int) -> int:
    """Return a register as a signed 16-bit number."""
    return register - 0x10000 if register >= 0x8000 else register


def scaled(value: float, decimals: int) -> int:
    """Return a temperature as the signed register that holds it in 10^-decimals; `ValueError` where none does."""
    register = round(value * 10.0**decimals)  # int() would make 1000 of 100.1
    if not -0x8000 <= register <= 0x7FFF:
        raise ValueError(f"{value:g} with {decimals} decimals does not fit into a register; nothing was sent")
    return register


def float_of(registers: Sequence[int]) -> float:
    """Return a 32-bit IEEE float from two registers, low word first (Watlow's and Binder's factory order)."""
    low, high = registers
    value: float = struct.unpack(">f", struct.pack(">HH", high, low))[0]
    return value


def registers_of(value: float) -> tuple[int, int]:
    """Return the two registers of a 32-bit IEEE float, low word first."""
    high, low = struct.unpack(">HH", struct.pack(">f", value))
    return low, high
