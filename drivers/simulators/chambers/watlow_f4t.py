r"""A Watlow F4T with a chamber behind it: its registers, and the SCPI port beside them.

    device = SimulatedWatlowF4t(ChamberPlant())
    scpi = SimulatedF4tScpi(device)
    device.receive(bytes.fromhex("00 01 00 00 00 06 01 03 0B 04 00 02"), 0.0)

Loop 1, floats low word first. Half of a float is read as it lies; writing half of one is exception 3. SCPI settings are
not answered, questions are (formats inferred).
"""

import struct
from typing import Any, Literal

from drivers.chambers import ChamberLimits
from drivers.simulators.chambers.controller import Refusal
from drivers.simulators.chambers.modbus import ILLEGAL_ADDRESS, ILLEGAL_VALUE, SimulatedModbus
from drivers.simulators.chambers.plant import ChamberPlant

_FLOATS = (2774, 2776, 2782, 2810, 2820)


class SimulatedWatlowF4t(SimulatedModbus):
    """A `SimulatedDevice`: an F4T."""

    def __init__(
        self, plant: ChamberPlant, *, framing: Literal["rtu", "tcp"] = "tcp", hardware: int = 124, **settings: Any
    ) -> None:
        self._hardware = hardware
        self.ramp = {"RSCALE": "HOURS", "RRATE": "0.0", "RACTION": "OFF"}
        super().__init__(plant, framing=framing, **settings)

    def set_ramp(self, name: str, value: str) -> None:
        """Set one of the three things that make a ramp; together they bound the air from the next setpoint on."""
        self.ramp[name] = value
        rate = float(self.ramp["RRATE"]) / (1.0 if self.ramp["RSCALE"] == "MINUTES" else 60.0)
        works = self.ramp["RACTION"] in ("SETPOINT", "BOTH")
        self._bound_ramp(rate if works else 0.0, rate if works else 0.0)

    def _register(self, address: int, now_s: float) -> int:
        for begins in _FLOATS:
            if address - begins in (0, 1):
                high, low = struct.unpack(">HH", struct.pack(">f", self._float(begins, now_s)))
                return int(low if address == begins else high)
        if 1356 <= address <= 1656 and (address - 1356) % 100 == 0:
            return 23 if str((address - 1256) // 100) in self.alarms else 61
        known = {
            0: self._hardware,
            1328: 30 if self.fahrenheit else 15,
            2730: 62 if self.mode == "OFF" else 10,
            2814: 62 if self.mode == "OFF" else 10,
            16568: 149 if self.mode == "RUN" else 1782,
        }
        if address not in known:
            raise Refusal(ILLEGAL_ADDRESS)
        return known[address]

    def _float(self, address: int, now_s: float) -> float:
        match address:
            case 2774:
                return self._shown(self.limits.low_degC)
            case 2776:
                return self._shown(self.limits.high_degC)
            case 2820:
                return self._air(now_s)
        return self._shown(self.setpoint_degC)

    def _set_registers(self, address: int, values: list[int]) -> None:
        if address not in _FLOATS or len(values) != 2:
            super()._set_registers(address, values)
            return
        value: float = struct.unpack(">f", struct.pack(">HH", values[1], values[0]))[0]
        self._set_float(address, round(self._taken(value), 4))

    def _set_float(self, address: int, degC: float) -> None:
        limits = ChamberLimits(
            degC if address == 2774 else self.limits.low_degC, degC if address == 2776 else self.limits.high_degC
        )
        setpoint = degC if address == 2782 else self.setpoint_degC
        if address not in (2774, 2776, 2782) or not limits.low_degC <= setpoint <= limits.high_degC:
            raise Refusal(ILLEGAL_VALUE)
        self.limits, self.setpoint_degC = limits, setpoint

    def _set_register(self, address: int, value: int) -> None:
        match address, value:
            case 2730, 62:
                self.mode = "OFF"
            case 2730, 10:
                self.mode = "CONSTANT" if self.mode == "OFF" else self.mode
            case 16566, 148:
                self.mode = "CONSTANT" if self.mode == "RUN" else self.mode
            case ((2730 | 16566 | 1328), _):
                raise Refusal(ILLEGAL_VALUE)
            case _ if any(address - begins in (0, 1) for begins in _FLOATS):
                raise Refusal(ILLEGAL_VALUE)
            case _:
                raise Refusal(ILLEGAL_ADDRESS)


class SimulatedF4tScpi:
    """A `SimulatedDevice`: the SCPI port of an F4T, as far as its ramp goes. `unit` is that of communication."""

    def __init__(self, device: SimulatedWatlowF4t, *, unit: str = "C", latency_s: float = 0.05) -> None:
        self._device = device
        self._unit = unit
        self._latency_s = latency_s
        self._line = b""
        self._pending: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, now_s: float) -> None:
        """Take lines; questions are answered."""
        self._line += data
        while b"\n" in self._line:
            line, self._line = self._line.split(b"\n", 1)
            reply = self._respond(line.decode("ascii", errors="replace").strip().upper())
            if reply is not None:
                self._pending.append((now_s + self._latency_s, reply.encode("ascii") + b"\n"))

    def transmit(self, now_s: float) -> bytes:
        """Return the replies that are due."""
        due = b"".join(reply for at_s, reply in self._pending if at_s <= now_s + 1e-9)
        self._pending = [(at_s, reply) for at_s, reply in self._pending if at_s > now_s + 1e-9]
        return due

    def next_transmission(self, now_s: float) -> float | None:
        """Return when the next reply is due, None where none is."""
        return max(now_s, self._pending[0][0]) if self._pending else None

    def _respond(self, request: str) -> str | None:
        if request == "*IDN?":
            return "Watlow Electric,F4T,SIMULATED,04:07:0012"
        if request == ":UNIT:TEMPERATURE?":
            return self._unit
        name, _, value = request.removeprefix(":SOURCE:CLOOP1:").partition(" ")
        ramp = self._device.ramp
        if name.endswith("?") and name[:-1] in ramp:
            return ramp[name[:-1]]
        if name in ramp and value:
            self._device.set_ramp(name, value)
        return None
