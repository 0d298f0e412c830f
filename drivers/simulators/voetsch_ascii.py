r"""A Vötsch chamber behind ASCII-2, with air behind it.

    device = SimulatedVoetschAscii(ChamberPlant(ambient_degC=11.2), setpoint_degC=10.0)
    device.receive(b"$00I\r", 0.0)
    device.transmit(0.1)                  # b"0010.0 0011.2 0000.0 … 0000000000000000\r"

A VT 4002: five pairs of nominal and actual value, sixteen bits. As in the manual's example, every pair shows the same
actual value. It conditions while start and temperature bit are both set. Bit 0 ("on") cannot be changed, bit 2 tells
of an error, `$00Q` clears the first one. What it cannot understand, and what a locked panel refuses, it does not answer
(inferred).
"""

from __future__ import annotations

import re
from typing import Any

from drivers.simulators.chamber_plant import ChamberPlant
from drivers.simulators.lines import SimulatedLines

_PAIRS, _BITS = 5, 16
_START, _ERROR, _TEMPER = 1, 2, 3
_NUMBER = r"-?\d{3,4}\.\d"
_WRITE = re.compile(rf"((?:{_NUMBER} ){{{_PAIRS}}})([01]{{{_BITS - 1},{_BITS}}})")
_GRADIENT = re.compile(rf"{_NUMBER}(?: {_NUMBER}){{{2 * _PAIRS - 1}}}")
_TEXTS = {"01": "software test spec.protection.."}  # as the manual prints it


class SimulatedVoetschAscii(SimulatedLines):
    """A `SimulatedDevice`: a VT 4002 whose remaining bits are `other_bits`."""

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        address: int = 0,
        other_bits: str = "0000000000000000",
        mode: str = "OFF",
        **settings: Any,
    ) -> None:
        self._address = f"${address:02d}"
        self._others = other_bits
        self._temper = False
        self.gradient_degC_per_min: tuple[float, float] = (0.0, 0.0)
        super().__init__(plant, mode=mode, **settings)

    def _respond(self, request: str, now_s: float) -> str | None:
        if not request.startswith(self._address):
            return None
        command, rest = request[3:4], request[4:].strip()
        match command:
            case "I":
                return self._everything(now_s)
            case "F":
                return f"{self.alarms[0]} {_TEXTS.get(self.alarms[0], 'error')}" if self.alarms else "00"
            case "Q":
                self.alarms = self.alarms[1:]
                return f"{len(self.alarms):02d}"
        self._refuse_if_locked()
        match command:
            case "E" if found := _WRITE.fullmatch(rest):
                self._write([float(number) for number in found[1].split()], found[2].rjust(_BITS, "0"))
            case "U" if _GRADIENT.fullmatch(rest):
                up, down, *_ = (float(number) for number in rest.split())
                self.gradient_degC_per_min = (up, down)
            case "P" if re.fullmatch(r"\d{4}", rest):
                self._program(int(rest))
            case _:
                return None
        return "0"

    def _everything(self, now_s: float) -> str:
        actual = f"{max(-999.9, min(9999.9, self._air(now_s))):06.1f}"
        nominal = [self._shown(self.setpoint_degC)] + [0.0] * (_PAIRS - 1)
        return " ".join([*(f"{value:06.1f} {actual}" for value in nominal), self._digital()])

    def _digital(self) -> str:
        bits = list(self._others)
        runs = self.mode in ("CONSTANT", "RUN")
        for place, on in ((_START, runs), (_TEMPER, runs or self._temper), (_ERROR, bool(self.alarms))):
            if on:
                bits[place] = "1"
        return "".join(bits)

    def _write(self, nominal: list[float], bits: str) -> None:
        self.setpoint_degC = self._taken(nominal[0])
        self._others = "".join("0" if place in (_START, _ERROR, _TEMPER) else bit for place, bit in enumerate(bits))
        self._temper = bits[_TEMPER] == "1"
        if self.mode != "RUN" or bits[_START] == "0":
            self.mode = "CONSTANT" if bits[_START] == bits[_TEMPER] == "1" else "OFF"

    def _program(self, number: int) -> None:
        if number:
            self.mode = "RUN"
        elif self.mode == "RUN":
            self.mode = "OFF"

    def _usual_alarm(self) -> str:
        return "02"

    def _power_up(self) -> None:
        self._temper = False
