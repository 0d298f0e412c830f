r"""A Modbus unit that answers for a bank of registers: RTU (also over TCP) or Modbus TCP.

pymodbus cuts and builds the frames; what the registers mean, and what is refused, is each controller's own. A frame
for another unit is not answered, and neither is one with a wrong checksum, as the standard has it. Oracles in the tests
are minimalmodbus as a client and the published frames, byte for byte.
"""

import struct
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerRTU
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsResponse, ReadDiscreteInputsResponse, WriteSingleCoilResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersResponse,
    ReadInputRegistersResponse,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterResponse,
)

from drivers.simulators.chambers.controller import Refusal, SimulatedController
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.modbus import Framing, Table, framer_of

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
    `Refusal` with the number of the exception. Faults know requests as `read 100` and `write 300`.
    """

    _silent_refusals = False  # a bad request is answered with nothing
    _coils = False  # it has coils
    _most_at_once = 60

    def __init__(self, plant: ChamberPlant, *, address: int = 1, framing: Framing = "rtu", **settings: Any) -> None:
        self._framer = framer_of(framing, of_unit=True)
        self._framing, self._address = framing, address
        self._functions = {
            function: "read" if function in _RESPONSES else "write"
            for function, table in _TABLES.items()
            if self._coils or table in ("holding", "input")
        }
        super().__init__(plant, **settings)

    @abstractmethod
    def _register(self, address: int, now_s: float, table: Table) -> int:
        """Return a register or coil, signed or unsigned; raise `Refusal` where there is none."""

    @abstractmethod
    def _set_registers(self, address: int, values: list[int], table: Table) -> None:
        """Write registers, unsigned, or a coil in one request; raise `Refusal` where they cannot be."""

    def _next_request(self) -> bytes | None:
        data = self._received
        if self._framing == "tcp":
            size = 6 + int.from_bytes(data[4:6], "big") if len(data) >= 6 else 0
        elif len(data) < 4:
            size = 0
        else:
            kind = self._framer.decoder.lookupPduClass(data)
            size = len(data) if kind is None else kind.calculateRtuFrameSize(data)
        if not size or len(data) < size:
            return None
        frame, self._received = data[:size], data[size:]
        return frame

    def _head(self, request: bytes) -> tuple[int, int, int]:
        body = request[6:] if self._framing == "tcp" else request
        return body[0], body[1], int.from_bytes(body[2:4], "big")

    def _is_mine(self, request: bytes) -> bool:
        whole = self._framing == "tcp" or FramerRTU.check_CRC(request[:-2], int.from_bytes(request[-2:], "big"))
        return whole and self._head(request)[0] == self._address

    def _name(self, request: bytes) -> str:
        _, function, address = self._head(request)
        return f"{self._functions.get(function, f'function {function}')} {address}"

    def _carry_out(self, request: bytes, now_s: float) -> bytes:
        if not self._is_mine(request):
            return b""
        if self._head(request)[1] not in self._functions:
            raise Refusal(ILLEGAL_FUNCTION)
        try:
            _, asked = self._framer.handleFrame(request, 0, 0)
        except (ModbusException, struct.error, ValueError):
            raise Refusal(ILLEGAL_VALUE) from None
        if asked is None:
            return b""
        answer = self._answer_to(asked, now_s)
        answer.dev_id, answer.transaction_id = asked.dev_id, asked.transaction_id
        return self._framer.buildFrame(answer)

    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        if self._silent_refusals or not self._is_mine(request):
            return b""
        transaction = int.from_bytes(request[:2], "big") if self._framing == "tcp" else 0
        unit, function, _ = self._head(request)
        return self._framer.buildFrame(ExceptionResponse(function, int(str(refusal)), unit, transaction))

    def _refusal(self) -> str:
        return ILLEGAL_VALUE

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
