r"""A Julabo circulator with a bath behind it.

    >>> device = SimulatedJulabo(ChamberPlant(), setpoint_degC=55.5)
    >>> device.receive(b"IN_SP_00\r", 0.0)
    >>> device.transmit(0.1)
    b'55.5\n'

`OUT` commands are not answered; what was wrong with one shows in `STATUS` until it is asked. An alarm stops the bath.
"""

from __future__ import annotations

import re
from typing import Any

from drivers.chambers import ChamberLimits
from drivers.simulators.chambers.controller import Refusal
from drivers.simulators.chambers.lines import SimulatedLines
from drivers.simulators.chambers.plant import ChamberPlant

_WRITE = re.compile(r"OUT_(SP_00|SP_03|SP_04|MODE_05) (-?\d+(?:\.\d*)?)")
_INVALID, _NOT_NOW, _TOO_SMALL, _TOO_LARGE = "-08", "-09", "-10", "-11"


class SimulatedJulabo(SimulatedLines):
    """A `SimulatedDevice`: a bath under remote control. `version` says by default that it is simulated."""

    _usual_alarm = "-01"

    def __init__(
        self, plant: ChamberPlant, *, version: str = "JULABO CRYOCOMPACT CF31 SIMULATED", **settings: Any
    ) -> None:
        self._version = version
        self._complaint: str | None = None
        super().__init__(plant, terminator=b"\r", reply_terminator=b"\n", **settings)

    def _respond(self, request: str, now_s: float) -> str | None:
        match request:
            case "VERSION":
                return self._version
            case "STATUS":
                return self._status()
            case "IN_PV_00":
                return f"{self._air(now_s):.2f}"
            case "IN_SP_00":
                return f"{self._shown(self.setpoint_degC):.1f}"
            case "IN_SP_03":
                return f"{self._shown(self.limits.high_degC):.2f}"
            case "IN_SP_04":
                return f"{self._shown(self.limits.low_degC):.2f}"
            case "IN_MODE_05":
                return str(int(self.mode != "OFF"))
        found = _WRITE.fullmatch(request)
        if found is None:
            raise Refusal(_INVALID)
        self._refuse_if_locked()
        self._write(found[1], float(found[2]))
        return None

    def _refuse(self, request: str, refusal: Refusal) -> str | None:
        del request
        self._complaint = str(refusal)
        return None

    def _refusal(self) -> str:
        return _NOT_NOW

    def _status(self) -> str:
        complaint, self._complaint = self._complaint, None
        if self.alarms:
            return f"{self.alarms[0]} ALARM"
        if complaint is not None:
            return f"{complaint} COMMAND"
        return "02 REMOTE STOP" if self.mode == "OFF" else "03 REMOTE START"

    def _write(self, parameter: str, value: float) -> None:
        degC = self._taken(value)
        match parameter:
            case "SP_00":
                if degC < -95.0:
                    raise Refusal(_TOO_SMALL)
                if degC > 350.0:
                    raise Refusal(_TOO_LARGE)
                self.setpoint_degC = degC
            case "SP_03":
                self.limits = ChamberLimits(self.limits.low_degC, degC)
            case "SP_04":
                self.limits = ChamberLimits(degC, self.limits.high_degC)
            case _:
                self.mode = "CONSTANT" if value == 1.0 else "OFF"
