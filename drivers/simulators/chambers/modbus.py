r"""A Modbus unit that answers for a bank of registers: RTU (also over TCP) or Modbus TCP.

pymodbus cuts and builds the frames; what the registers mean, and what is refused, is each controller's own. A frame
for another unit is not answered, and neither is one with a wrong checksum, as the standard has it. Oracles in the tests
are minimalmodbus as a client and the published frames, byte for byte.
"""

import struct
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Literal

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsResponse, ReadDiscreteInputsResponse, WriteSingleCoilResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersResponse,
    ReadInputRegistersResponse,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterResponse,
)

from drivers.simulators.chambers.controller import Refusal, SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.modbus import Table

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = "1", "2", "3"
_BY_TABLE: Mapping[Table, tuple[int, ...]] = {"coil": (1, 5), "discrete": (2,), "holding": (3, 6, 16), "input": (4,)}
_TABLES: Mapping[int, Table] = {function: table for table, several in _BY_TABLE.items() for function in several}
_RESPONSES = {
    1: ReadCoilsResponse,
    2: ReadDiscreteInputsResponse,
    3: ReadHoldingRegistersResponse,
    4: ReadInputRegistersResponse,
}


class SimulatedModbus(SimulatedController):
    """A `SimulatedDevice` with registers.

    A controller says what is in a register (`_register`) and what writing them does (`_set_registers`); both raise
    `Refusal` with the number of the exception. Faults know requests as `read 100` and `write 300`. `silent_refusals`
    is for units that answer a bad request with nothing, `coils` for those that have coils.
    """

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        address: int = 1,
        framing: Literal["rtu", "tcp"] = "rtu",
        silent_refusals: bool = False,
        most_at_once: int = 60,
        coils: bool = False,
        **settings: Any,
    ) -> None:
        decoder = DecodePDU(True)
        self._framer: FramerBase = FramerRTU(decoder) if framing == "rtu" else FramerSocket(decoder)
        self._framing = framing
        self._address = address
        self._silent_refusals = silent_refusals
        self._most_at_once = most_at_once
        self._functions = {
            function: "read" if function in _RESPONSES else "write"
            for function, table in _TABLES.items()
            if coils or table in ("holding", "input")
        }
        super().__init__(plant, **settings)

    @abstractmethod
    def _register(self, address: int, now_s: float, table: Table) -> int:
        """Return a register or coil, signed or unsigned; raise `Refusal` where there is none."""

    @abstractmethod
    def _set_registers(self, address: int, values: list[int], table: Table) -> None:
        """Write registers, unsigned, or a coil in one request; raise `Refusal` where they cannot be."""

    def _next_request(self) -> bytes | None:
        """Cut one frame off; throw away what cannot be one, as a unit does at the next pause on the line."""
        if self._framing == "tcp":
            if len(self._received) < 6 or len(self._received) < (
                size := 6 + int.from_bytes(self._received[4:6], "big")
            ):
                return None
        else:
            if len(self._received) < 4:
                return None
            kind = self._framer.decoder.lookupPduClass(self._received)
            if kind is None:
                size = len(self._received)
            else:
                size = kind.calculateRtuFrameSize(self._received)
                if not size or len(self._received) < size:
                    return None
        frame, self._received = self._received[:size], self._received[size:]
        return frame

    def _name(self, request: bytes) -> str:
        function, address = self._head(request)
        return f"{self._functions.get(function, f'function {function}')} {address}"

    def _head(self, request: bytes) -> tuple[int, int]:
        body = request[6:] if self._framing == "tcp" else request
        return body[1], int.from_bytes(body[2:4], "big")

    def _carry_out(self, request: bytes, now_s: float) -> bytes:
        asked = self._decode(request)
        if asked is None:
            return b""
        return self._framer.buildFrame(self._reply(asked, now_s))

    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        asked = self._framing == "tcp" or FramerRTU.check_CRC(request[:-2], int.from_bytes(request[-2:], "big"))
        unit = request[6] if self._framing == "tcp" else request[0]
        if self._silent_refusals or not asked or unit != self._address:
            return b""
        transaction = int.from_bytes(request[:2], "big") if self._framing == "tcp" else 0
        function, _ = self._head(request)
        return self._framer.buildFrame(
            ExceptionResponse(function, int(str(refusal)), device_id=unit, transaction=transaction)
        )

    def _refusal(self) -> str:
        return ILLEGAL_VALUE

    def _decode(self, request: bytes) -> ModbusPDU | None:
        """Return the request, None where it is damaged or for another unit."""
        function, _ = self._head(request)
        unit = request[6] if self._framing == "tcp" else request[0]
        if unit != self._address:
            return None
        if function not in self._functions:
            if self._framing == "rtu" and not FramerRTU.check_CRC(request[:-2], int.from_bytes(request[-2:], "big")):
                return None
            raise Refusal(ILLEGAL_FUNCTION)
        try:
            return self._framer.handleFrame(request, 0, 0)[1]
        except (ModbusException, struct.error, ValueError):
            raise Refusal(ILLEGAL_VALUE) from None

    def _reply(self, asked: ModbusPDU, now_s: float) -> ModbusPDU:
        answer = self._answer_to(asked, now_s)
        answer.dev_id, answer.transaction_id = asked.dev_id, asked.transaction_id
        return answer

    def _answer_to(self, asked: ModbusPDU, now_s: float) -> ModbusPDU:
        table, function = _TABLES[asked.function_code], asked.function_code
        if function in _RESPONSES:
            if asked.count > self._most_at_once:
                raise Refusal(ILLEGAL_VALUE)
            found = [self._register(asked.address + place, now_s, table) & 0xFFFF for place in range(asked.count)]
            if table in ("coil", "discrete"):
                return _RESPONSES[function](bits=[bool(each) for each in found])
            return _RESPONSES[function](registers=found)
        self._refuse_if_locked()
        self._set_registers(asked.address, [int(each) for each in asked.bits or asked.registers], table)
        if function == 5:
            return WriteSingleCoilResponse(address=asked.address, bits=asked.bits)
        if function == 6:
            return WriteSingleRegisterResponse(address=asked.address, registers=asked.registers)
        return WriteMultipleRegistersResponse(address=asked.address, count=asked.count)
