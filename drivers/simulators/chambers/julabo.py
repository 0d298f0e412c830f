r"""A Julabo circulator with a bath behind it.

    >>> device = SimulatedJulabo(ChamberPlant(), setpoint_degC=55.5)
    >>> device.receive(b"IN_SP_00\r", 0.0)
    >>> device.transmit(0.1)
    b'55.5\n'

Requests may be in lower case, as the manual prints some. `OUT` commands are not answered; what was wrong with one
shows in `STATUS` until it is asked. An alarm stops the bath.
"""

import re
from typing import Any

from drivers.chambers import ChamberLimits
from drivers.chambers.controllers.julabo import WarningLimits
from drivers.simulators.chambers.controller import Refusal
from drivers.simulators.chambers.lines import SimulatedLines
from drivers.simulators.chambers.plant import ChamberPlant

_WRITE = re.compile(r"OUT_(SP_0\d|MODE_05) (-?\d+(?:\.\d*)?)")
_INVALID, _NOT_NOW, _TOO_SMALL, _TOO_LARGE = "-08", "-09", "-10", "-11"


class SimulatedJulabo(SimulatedLines):
    """A `SimulatedDevice`: a bath under remote control. `version` says by default that it is simulated.

    `warning_limits` are the parameters under which its model has them; it does not know others.
    """

    _usual_alarm = "-01"

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        version: str = "JULABO CRYOCOMPACT CF31 SIMULATED",
        warning_limits: WarningLimits = "SP_03/04",
        **settings: Any,
    ) -> None:
        self._high, _, low = warning_limits.partition("/")
        self._low = f"SP_{low}"
        self._version = version
        self._complaint: str | None = None
        super().__init__(plant, terminator=b"\r", reply_terminator=b"\n", **settings)

    def _respond(self, request: str, now_s: float) -> str | None:
        request = request.upper()
        match request:
            case "VERSION":
                return self._version
            case "STATUS":
                return self._status()
            case "IN_PV_00":
                return f"{self._air(now_s):.2f}"
            case "IN_SP_00":
                return f"{self._shown(self.setpoint_degC):.1f}"
            case "IN_MODE_05":
                return str(int(self.mode != "OFF"))
        if request in (f"IN_{self._high}", f"IN_{self._low}"):
            return f"{self._shown(self.limits.high_degC if request.endswith(self._high) else self.limits.low_degC):.2f}"
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
        if parameter == "MODE_05":
            self.mode = "CONSTANT" if value == 1.0 else "OFF"
        elif parameter == "SP_00":
            if not -95.0 <= degC <= 350.0:
                raise Refusal(_TOO_SMALL if degC < -95.0 else _TOO_LARGE)
            self.setpoint_degC = degC
        elif parameter == self._high:
            self.limits = ChamberLimits(self.limits.low_degC, degC)
        elif parameter == self._low:
            self.limits = ChamberLimits(degC, self.limits.high_degC)
        else:
            raise Refusal(_INVALID)
