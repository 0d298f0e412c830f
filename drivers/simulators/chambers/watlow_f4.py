r"""A Watlow F4 with a chamber behind it.

    >>> device = SimulatedWatlowF4(ChamberPlant())
    >>> device.receive(bytes.fromhex("01 03 00 64 00 01 C5 D5"), 0.0)
    >>> device.transmit(0.1).hex(" ")  # 00 dc: 22.0 °C
    '01 03 02 00 dc b9 dd'

Registers it does not know are exception 2, values it does not take exception 3, functions other than 3, 4, 6 and 16
exception 1; a wrong checksum is silence. Setpoints beyond its limits, and limits that exclude the setpoint, are
exception 3 (inferred). It conditions while its event output is on and no profile runs; an alarm switches nothing off by
itself on a real F4 and does here, as in a chamber whose alarm relay is wired to its contactor.
"""

from typing import Any

from drivers.chambers import ChamberLimits
from drivers.simulators.chambers.controller import Refusal
from drivers.simulators.chambers.modbus import ILLEGAL_ADDRESS, ILLEGAL_VALUE, SimulatedModbus, signed
from drivers.simulators.chambers.plant import ChamberPlant

_INPUT_RANGE = 400.0  # beyond it the input reports an error


class SimulatedWatlowF4(SimulatedModbus):
    """A `SimulatedDevice`: an F4 with `decimals` on channel 1, whose `enable_event` switches the chamber."""

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        model: int = 5270,
        decimals: int = 1,
        enable_event: int = 1,
        limits: ChamberLimits = ChamberLimits(-75.0, 185.0),  # noqa: B008 - frozen
        **settings: Any,
    ) -> None:
        self._model = model
        self._decimals = decimals
        self._enable = 2000 + 10 * (enable_event - 1)
        super().__init__(plant, limits=limits, **settings)

    def _register(self, address: int, now_s: float) -> int:
        if 2000 <= address <= 2070 and address % 10 == 0:
            return int(address == self._enable and self.mode != "OFF")
        if address in (103, 104, 105, 107, 108, 109, 1217):
            return 0
        known = {
            0: self._model,
            100: self._raw(self._air(now_s)),
            101: int(abs(self._air(now_s)) > _INPUT_RANGE),
            102: int("1" in self.alarms),
            106: int("2" in self.alarms),
            200: 2 if self.mode == "RUN" else 1,
            300: self._raw(self._shown(self.setpoint_degC)),
            602: self._raw(self._shown(self.limits.low_degC)),
            603: self._raw(self._shown(self.limits.high_degC)),
            606: self._decimals,
            608: 0,
            901: int(not self.fahrenheit),
        }
        if address not in known:
            raise Refusal(ILLEGAL_ADDRESS)
        return known[address]

    def _set_register(self, address: int, value: int) -> None:
        match address:
            case 300:
                self._set(setpoint=self._value(value))
            case 602:
                self._set(low=self._value(value))
            case 603:
                self._set(high=self._value(value))
            case 606 if value <= 3:
                self._decimals = value
            case 901 if value <= 1:
                self.fahrenheit = value == 0
            case 1217 if value == 1:
                self.mode = "CONSTANT" if self.mode == "RUN" else self.mode
            case self._enable if value <= 1:
                self._switch(on=value == 1)
            case _ if 2000 <= address <= 2070 and address % 10 == 0 and value <= 1:
                pass
            case 300 | 602 | 603 | 606 | 901 | 1217 | self._enable:
                raise Refusal(ILLEGAL_VALUE)
            case _:
                raise Refusal(ILLEGAL_ADDRESS)

    def _set(self, *, setpoint: float | None = None, low: float | None = None, high: float | None = None) -> None:
        low = self.limits.low_degC if low is None else low
        high = self.limits.high_degC if high is None else high
        setpoint = self.setpoint_degC if setpoint is None else setpoint
        if not low <= setpoint <= high:
            raise Refusal(ILLEGAL_VALUE)
        self.setpoint_degC, self.limits = setpoint, ChamberLimits(low, high)

    def _switch(self, *, on: bool) -> None:
        if not on:
            self.mode = "OFF"
        elif self.mode == "OFF":
            self.mode = "CONSTANT"

    def _raw(self, shown: float) -> int:
        return max(-0x8000, min(0x7FFF, round(shown * 10.0**self._decimals)))

    def _value(self, register: int) -> float:
        return round(self._taken(signed(register) / 10.0**self._decimals), 6)
