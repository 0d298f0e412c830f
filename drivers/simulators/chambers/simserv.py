r"""A SimServ control panel with a chamber behind it.

    >>> device = SimulatedSimServ(ChamberPlant())
    >>> device.receive("11004¶1¶1\r".encode("latin-1"), 0.0)
    >>> device.transmit(0.1).decode("latin-1")
    '1¶22.000\r\n'

Requests are those of its clients; every reply is inferred from what they parse. A leading `\xb6`, which one of them
sends, is tolerated. A setpoint beyond its limits is error -6, a locked panel -12. An alarm stops it.
"""

from collections.abc import Callable
from typing import Any

from drivers.simulators.chambers.controller import Refusal, SimulatedLines
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.framing import lines

_SEPARATOR = "\xb6"
_UNKNOWN, _WRONG_PARAMETERS, _NO_PRIVILEGE, _NO_CHAMBER = "-5", "-6", "-12", "-4"


class SimulatedSimServ(SimulatedLines):
    """A `SimulatedDevice`: one chamber with one control variable. `model` says by default that it is simulated."""

    _usual_alarm = "temperature limiter test space"

    def __init__(self, plant: ChamberPlant, *, model: str = "LabEvent T/110/70/3 simulated", **settings: Any) -> None:
        self._model = model
        self._gradients = {"11068": 0.0, "11072": 0.0}  # up and down, °C/min, by the command that sets them
        super().__init__(plant, lines(b"\r", b"\r\n", "latin-1"), **settings)

    def _respond(self, request: str, now_s: float) -> str | None:
        command, *arguments = request.removeprefix(_SEPARATOR).split(_SEPARATOR)
        if not arguments or arguments[0] != "1":
            raise Refusal(_NO_CHAMBER)
        try:
            reply = self._ask(command, [float(argument) for argument in arguments[1:]], now_s)
        except (ValueError, IndexError):
            raise Refusal(_WRONG_PARAMETERS) from None
        return "1" if reply is None else f"1{_SEPARATOR}{reply}"

    def _refuse(self, refusal: Refusal) -> str:
        return str(refusal)

    def _refusal(self) -> str:
        return _NO_PRIVILEGE

    def _ask(self, command: str, numbers: list[float], now_s: float) -> str | None:
        reads: dict[str, Callable[[], str]] = {
            "99997": lambda: [self._model, "2026", "0"][int(numbers[0]) - 1],
            "11004": lambda: f"{self._air(now_s):.3f}",
            "11002": lambda: f"{self._shown(self.setpoint_degC):.1f}",
            "11007": lambda: f"{self._shown(self.limits.low_degC):.1f}",
            "11009": lambda: f"{self._shown(self.limits.high_degC):.1f}",
            "11023": lambda: "°F" if self.fahrenheit else "°C",
            "10012": lambda: str((3 if self.mode in ("CONSTANT", "RUN") else 1) + (8 if self.alarms else 0)),
            "14003": lambda: str(int(self.mode == "CONSTANT")),
            "11066": lambda: f"{self._gradients['11068']:g}",
            "11070": lambda: f"{self._gradients['11072']:g}",
            "17002": lambda: str(len(self.alarms)),
            "17005": lambda: "1",
            "17007": lambda: self.alarms[int(numbers[0]) - 1],
            "17009": lambda: "1",
        }
        if command in reads:
            return reads[command]()
        self._refuse_if_locked()
        match command:
            case "11001":
                setpoint_degC = self._taken(numbers[1])
                if not self.limits.low_degC <= setpoint_degC <= self.limits.high_degC:
                    raise Refusal(_WRONG_PARAMETERS)
                self.setpoint_degC = setpoint_degC
            case "14001" if numbers[1] == 1.0:
                self.mode = "RUN" if self.mode == "RUN" else "CONSTANT"
            case "14001":
                self.mode = "OFF"
            case "11068" | "11072":
                self._gradients[command] = numbers[1]
                self.plant.ramp_degC_per_min = tuple(self._gradients.values())
            case "19014":
                self.mode = "RUN"
            case "19015":
                self.mode = "OFF" if self.mode == "RUN" else self.mode
            case "17012":
                self.alarms = ()
            case _:
                raise Refusal(_UNKNOWN)
        return None
