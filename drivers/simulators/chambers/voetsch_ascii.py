r"""A Vötsch chamber behind ASCII-2, with air behind it.

    >>> device = SimulatedVoetschAscii(ChamberPlant(ambient_degC=11.2), setpoint_degC=10.0)
    >>> device.receive(b"$00I\r", 0.0)
    >>> device.transmit(0.1)
    b'0010.0 0011.2 0000.0 0011.2 0000.0 0011.2 0000.0 0011.2 0000.0 0011.2 0000000000000000\r'

A VT 4002 unless `layout` says otherwise: five pairs of nominal and actual value, sixteen bits. As in the manual's
example, every pair shows the same actual value. It conditions while start and temperature bit are both set. The error
bit tells of an error, `$00Q` clears the first one. What it cannot understand, and what a locked panel refuses, it does
not answer (inferred). A gradient bounds how fast the air moves; 0 means none (inferred).
"""

import re
from typing import Any

from drivers.chambers.controllers.voetsch_ascii import AsciiLayout
from drivers.simulators.chambers.controller import SimulatedLines
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.framing import Terminator, lines

_NUMBER = r"-?\d{3,4}\.\d"
_TEXTS = {"01": "software test spec.protection.."}  # as the manual prints it


class SimulatedVoetschAscii(SimulatedLines):
    """A `SimulatedDevice`. `other_bits` are the bits that the layout does not name, all 0 where they are not given."""

    _usual_alarm = "02"
    _temper = False

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        address: int = 0,
        other_bits: str | None = None,
        layout: AsciiLayout | None = None,
        terminator: Terminator = "CR",
        **settings: Any,
    ) -> None:
        self._address = f"${address:02d}"
        self._layout = layout = layout or AsciiLayout()
        self._named = {layout.start_bit, layout.error_bit, layout.channel_bit}
        # One leading 0 may be lost, as in the manual's printed example.
        self._writes = re.compile(rf"((?:{_NUMBER} ){{{layout.written}}})([01]{{{layout.bits - 1},{layout.bits}}})")
        self._gradient = re.compile(rf"{_NUMBER}(?: {_NUMBER}){{{2 * layout.written - 1}}}")
        self._others = other_bits or "0" * layout.bits
        super().__init__(plant, lines(terminator), **settings)

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
            case "E" if found := self._writes.fullmatch(rest):
                self._write([float(number) for number in found[1].split()], found[2].rjust(self._layout.bits, "0"))
            case "U" if self._gradient.fullmatch(rest):
                self.plant.ramp_degC_per_min = tuple(map(float, rest.split()[:2]))
            case "P" if re.fullmatch(r"\d{4}", rest):
                self.mode = "RUN" if int(rest) else "OFF" if self.mode == "RUN" else self.mode
            case _:
                return None
        return "0"

    def _everything(self, now_s: float) -> str:
        actual = f"{max(-999.9, min(9999.9, self._air(now_s))):06.1f}"
        nominal = [f"{self._shown(self.setpoint_degC):06.1f}"] + ["0000.0"] * (self._layout.pairs - 1)
        pairs = (f"{value} {actual}" if self._layout.nominal_first else f"{actual} {value}" for value in nominal)
        layout, runs = self._layout, self.mode in ("CONSTANT", "RUN")
        on = {
            layout.start_bit: runs,
            layout.channel_bit: runs or self._temper,
            layout.error_bit: bool(self.alarms),
        }
        return " ".join([*pairs, "".join("1" if on.get(place) else bit for place, bit in enumerate(self._others))])

    def _write(self, nominal: list[float], bits: str) -> None:
        self.setpoint_degC = self._taken(nominal[0])
        self._others = "".join("0" if place in self._named else bit for place, bit in enumerate(bits))
        starts, channel = bits[self._layout.start_bit] == "1", self._layout.channel_bit
        self._temper = channel is None or bits[channel] == "1"
        if self.mode != "RUN" or not starts:
            self.mode = "CONSTANT" if starts and self._temper else "OFF"

    def _power_up(self) -> None:
        self._temper = False
