r"""A Cincinnati Sub-Zero EZT-570i with a chamber behind it.

    >>> device = SimulatedEzt570i(ChamberPlant(ambient_degC=23.6))
    >>> device.receive(bytes.fromhex("01 03 00 3D 00 01 15 C6"), 0.0)
    >>> device.transmit(0.1).hex(" ")  # the manual's own example
    '01 03 02 00 ec b9 c9'

Whatever it does not like it does not answer, and it ignores a request within half a second of its last reply. Its
setpoint limits do not guard the line: a setpoint beyond them is taken, as the manual warns. An alarm of the chamber
shuts it down.
"""

from typing import Any

from drivers.chambers import ChamberLimits
from drivers.simulators.chambers.controller import Refusal
from drivers.simulators.chambers.modbus import ILLEGAL_ADDRESS, SimulatedModbus, signed
from drivers.simulators.chambers.plant import ChamberPlant

_OTHER_EVENTS = 0x0010  # something else that somebody has switched on, and wants left on


class SimulatedEzt570i(SimulatedModbus):
    """A `SimulatedDevice`: an EZT-570i with one loop. `online` False freezes its values, as maintenance does."""

    _usual_alarm = "32"  # bit 0 of word 57: heater high limit

    def __init__(self, plant: ChamberPlant, *, online: bool = True, pause_s: float = 0.5, **settings: Any) -> None:
        self.online = online
        self.other_events = _OTHER_EVENTS
        super().__init__(plant, silent_refusals=True, pause_s=pause_s, **settings)

    def _register(self, address: int, now_s: float) -> int:
        if not (0 <= address < 200):
            raise Refusal(ILLEGAL_ADDRESS)
        if 55 <= address <= 58:
            return sum(1 << (int(alarm) % 16) for alarm in self.alarms if int(alarm) // 16 == address - 55)
        match address:
            case 0:
                return int(self.online)
            case 22:
                return self.other_events | int(self.mode != "OFF")
            case 24:
                return 4 if self.mode == "RUN" else 0
            case 60:
                return _tenths(self._shown(self.setpoint_degC))
            case 61:
                return _tenths(self._air(now_s))
            case 64:
                return _tenths(self._shown(self.limits.high_degC))
            case 65:
                return _tenths(self._shown(self.limits.low_degC))
        return 0

    def _set_register(self, address: int, value: int) -> None:
        shown = self._taken(signed(value) / 10.0)
        match address:
            case 22:
                self.other_events = value & ~1
                if not value & 1:
                    self.mode = "OFF"
                elif self.mode == "OFF":
                    self.mode = "CONSTANT"
            case 24:
                if value in (0, 1) and self.mode == "RUN":
                    self.mode = "CONSTANT"
            case 54:
                self.alarms = ()
            case 60:
                self.setpoint_degC = shown
            case 64:
                self.limits = ChamberLimits(self.limits.low_degC, shown)
            case 65:
                self.limits = ChamberLimits(shown, self.limits.high_degC)
            case _:
                raise Refusal(ILLEGAL_ADDRESS)


def _tenths(shown: float) -> int:
    return max(-0x8000, min(0x7FFF, round(shown * 10.0)))
