r"""A Thermotron with a chamber behind it.

    >>> device = SimulatedThermotron(ChamberPlant())
    >>> device.receive(b"PVAR1?\r", 0.0)
    >>> device.transmit(0.1)
    b'22.000\r'

`replies` is how operations are answered: `echo` as the 8200's frames show it (a setpoint is echoed, RUNM and STOP are
not answered), `code` as the 8800's page says it (0 for done). A new setpoint waits for RUNM. An alarm stops it.
"""

import re
from typing import Any, Literal

from drivers.simulators.chambers.controller import Refusal
from drivers.simulators.chambers.lines import SimulatedLines
from drivers.simulators.chambers.plant import ChamberPlant

_SETPOINT = re.compile(r"SETP1,(-?\d+(?:\.\d*)?)")


class SimulatedThermotron(SimulatedLines):
    """A `SimulatedDevice`: channel 1 of a Thermotron. `model` says by default that it is simulated."""

    _usual_alarm = "5"

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        model: str = "8800 SIMULATED",
        replies: Literal["echo", "code"] = "code",
        **settings: Any,
    ) -> None:
        self._model = model
        self._replies = replies
        self._waiting: float | None = None
        super().__init__(plant, **settings)

    def _respond(self, request: str, now_s: float) -> str | None:
        match request:
            case "IDEN?":
                return self._model
            case "PVAR1?":
                return f"{self._air(now_s):.3f}"
            case "SETP1?":
                return f"{self._shown(self.setpoint_degC):.3f}"
            case "MODE?":
                return {"CONSTANT": "16", "RUN": "1"}.get(self.mode, "2")
            case "ALRM1?":
                return str(sum(1 << int(alarm) for alarm in set(self.alarms)))
        self._refuse_if_locked()
        if found := _SETPOINT.fullmatch(request):
            self._waiting = self._taken(float(found[1]))
            if self.mode != "CONSTANT":
                self._take_effect()
            return f"{float(found[1]):.3f}" if self._replies == "echo" else "0"
        match request:
            case "RUNM":
                self._take_effect()
                self.mode = "CONSTANT"
            case "STOP" | "INIT":
                self.mode = "OFF"
            case _:
                raise Refusal(self._refusal())
        return None if self._replies == "echo" else "0"

    def _take_effect(self) -> None:
        if self._waiting is not None:
            self.setpoint_degC, self._waiting = self._waiting, None

    def _refuse(self, request: str, refusal: Refusal) -> str | None:
        del request
        return str(refusal) if self._replies == "code" else None

    def _refusal(self) -> str:
        return "5"

    def _power_up(self) -> None:
        self._waiting = None
