r"""An ESPEC ASCII controller with a chamber behind it, byte for byte, and with faults in front of it.

    >>> device = SimulatedEspec(ChamberPlant(), limits=ChamberLimits(-75.0, 105.0))
    >>> device.receive(b"TEMP?\r\n", now_s=0.0)
    >>> device.transmit(now_s=0.1)
    b'22.0,23.0,105.0,-75.0\r\n'

Independent of the driver: it formats and judges by itself. As real ones do, it refuses a setpoint beyond its alarm
limits, and forgets its setpoint and its timer with its power. The vendor asks for a pause before the next request (0.3
s after a monitor command, 0.5 s after a setting); what a controller does with one that comes sooner, no manual says,
and public clients do not pause. Where it is `strict`, it is dropped without a word. Byte-exact from sources: `TEMP?`,
`TYPE?`, `HUMI?`, `MON?`, `CONSTANT SET?,TEMP`, the `OK` spellings, `CMD ERR`, `DATA OUT OF RANGE`, `INVALID REQ`; the
requests that begin with `TIMER`. Inferred: the replies to `TIMER LIST?,0`, `TIMER ON?` and to what nothing here asks
(`_OTHERS`, from a client's parser), that an alarm stops the chamber to STANDBY, that crossing an alarm limit raises
code 1, and that an alarm limit which would exclude the setpoint is refused.
"""

import re
from typing import Any

from drivers.chambers import ChamberLimits
from drivers.simulators.chambers.controller import ChamberFault, ChamberFaultKind, Refusal, SimulatedLines
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.framing import Terminator, lines

_PAUSE_AFTER_MONITOR_S = 0.3
_PAUSE_AFTER_SETTING_S = 0.5
_LIMIT_ALARM = "1"
_OTHERS = {"SET?": "REF9", "RELAY?": "0", "REF?": "1,OFF1", "DATE?": "26.01/01", "TIME?": "00:00:00"}
_OTHERS |= {"SRQ?": "00000000", "MASK?": "00000000"}
_MONITORS = ("TEMP?", "MON?", "MODE?", "ALARM?", "CONSTANT SET?", "ROM?", "TYPE?", "HUMI?", "TIMER LIST?", "TIMER ON?")
_SETTINGS = ("TEMP", "MODE", "POWER", "PRGM", "TIMER WRITE", "TIMER")
_TARGETS = re.compile(r"(?:[SHL]-?\d+(?:\.\d+)?(?:\s+|$))+")
_TARGET = re.compile(r"([SHL])(-?\d+(?:\.\d+)?)")
_PROGRAM_ENDS = {"STANDBY": "STANDBY", "OFF": "OFF", "CONST": "CONSTANT", "HOLD": "RUN"}


class SimulatedEspec(SimulatedLines):
    """A `SimulatedDevice`: the controller of one chamber.

    `limits` are the alarm limits as the last user left them. A fault's text is what a refusal says after `NA:`, the
    code of an alarm, or what a broken sensor shows.
    """

    model = "P300 SIMULATED 1.00"  # the reply to ROM?
    type_text = "T,T,P3,180.0"  # to TYPE?
    humidity: str | None = None  # to HUMI?, of a chamber that has it
    acknowledgement = "OK:{0}"  # or, with the address and the command, "OK : {1},{2}", as {3} in small letters
    strict = False  # drops what comes before a pause is over
    timer_ends_s: float | None = None
    _hardware = ChamberLimits(-80.0, 190.0)  # bound what the alarm limits can be set to
    _timer = ("STANDBY", 0)  # the mode that it leads to, and after how many minutes
    _shown_instead: str | None = None
    _usual_alarm = "19"
    _stopped = "STANDBY"

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        address: int | None = None,
        terminator: Terminator = "CR LF",
        **settings: Any,
    ) -> None:
        self._address = address
        super().__init__(plant, lines(terminator), **{"limits": ChamberLimits(-75.0, 105.0), **settings})

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the host; every complete line is a request. An air beyond its limits is seen then."""
        self._suffer(now_s)
        watches = self.mode in ("CONSTANT", "RUN") and _LIMIT_ALARM not in self.alarms
        if watches and not self.limits.low_degC <= self.plant.advance(now_s) <= self.limits.high_degC:
            self.alarms, self.mode = (*self.alarms, _LIMIT_ALARM), self._stopped
            self._condition(now_s)
        super().receive(data, now_s)

    # What arrives.

    def _take(self, request: bytes, now_s: float) -> None:
        """Answer one line, where it is for this controller."""
        if self._command(request) is not None:
            super()._take(request, now_s)

    def _command(self, request: bytes) -> str | None:
        """Return the command without its address, None where it is for another controller on the same line."""
        text = self._text(request)
        if self._address is None:
            return text
        addressed = re.match(r"(\d+)\s*,\s*(.*)", text)
        return addressed[2] if addressed and int(addressed[1]) == self._address else None

    def _name(self, request: bytes) -> str:
        return self._command(request) or ""

    def _pause_after(self, request: bytes) -> float:
        usual = _PAUSE_AFTER_MONITOR_S if b"?" in request else _PAUSE_AFTER_SETTING_S
        return usual if self.strict else 0.0

    def _respond(self, request: str, now_s: float) -> str | None:
        command = self._command(request.encode(errors="replace")) or ""
        return self._monitor(command, now_s) if "?" in command else self._setting(command, request, now_s)

    def _refuse(self, refusal: Refusal) -> str:
        return f"NA:{refusal}"

    def _refusal(self) -> str:
        return "PROTECT ON" if self.panel_locked else "CMD ERR"

    # What happens by itself.

    def _turn(self, fault: ChamberFault, *, on: bool) -> None:
        super()._turn(fault, on=on)
        if fault.kind is ChamberFaultKind.SENSOR_BROKEN:
            self._shown_instead = fault.text if on else None

    def _suffer(self, now_s: float) -> None:
        super()._suffer(now_s)
        if self.timer_ends_s is not None and now_s >= self.timer_ends_s:
            if self.mode != "OFF":
                self.mode = self._timer[0]
            self._condition(self.timer_ends_s)
            self.timer_ends_s = None

    def _power_up(self) -> None:
        self.timer_ends_s = None

    # What it says.

    def _monitor(self, command: str, now_s: float) -> str:
        """Return the data that a monitor command asks for."""
        if command in ("MON?,DETAIL", "MODE?,DETAIL"):
            if not self.model.startswith("P3"):
                raise Refusal("PARA ERR")
            command = command.removesuffix(",DETAIL")
        if command == "HUMI?" and self.humidity is None:
            raise Refusal("INVALID REQ")
        held = (self.setpoint_degC, self.limits.high_degC, self.limits.low_degC)
        air = f"{self._air(now_s):.1f}" if self._shown_instead is None else self._shown_instead
        (after, minutes), conditions = self._timer, f"{50.0 * (self.mode == 'CONSTANT'):.1f}"
        said = _OTHERS | {
            "TEMP?": ",".join((air, *(f"{self._shown(each):.1f}" for each in held))),
            "MON?": f"{air},{(self.humidity or '').partition(',')[0]},{self.mode},{len(self.alarms)}",
            "MODE?": self.mode,
            "ALARM?": ",".join((str(len(self.alarms)), *self.alarms)),
            "CONSTANT SET?,TEMP": f"{self._shown(self.setpoint_degC):.1f},ON",
            "ROM?": self.model,
            "TYPE?": self.type_text,
            "HUMI?": self.humidity or "",
            "TIMER LIST?,0": f"{after},{minutes // 60}:{minutes % 60}",
            "TIMER ON?": "0" if self.timer_ends_s is None else "1,0",
            "TIMER USE?": "1,0" if minutes else "0",
            "KEYPROTECT?": "ON" if self.panel_locked else "OFF",
            "%?": f"1,{conditions}" if self.humidity is None else f"2,{conditions},0.0",
        }
        if command in said:
            return said[command]
        raise Refusal("PARA ERR" if command.split(",")[0] in _MONITORS else "CMD ERR")

    # What it does.

    def _setting(self, command: str, request: str, now_s: float) -> str:
        """Carry out a setting and return its acknowledgement."""
        head, _, parameter = command.partition(",")
        parameter = parameter.strip()
        if head not in _SETTINGS:
            raise Refusal("CMD ERR")
        self._refuse_if_locked()
        match head, parameter:
            case "TEMP", _:
                self._set_temperatures(parameter)
            case "MODE", "OFF" | "STANDBY" | "CONSTANT":
                self.mode = parameter
            case "POWER", "OFF":
                self.mode = "OFF"
            case "POWER", "ON":
                self.mode = "STANDBY" if self.mode == "OFF" else self.mode
            case "PRGM", _:
                self._set_program(parameter)
            case "TIMER WRITE", _ if written := re.fullmatch(r"NO0,(\d+):([0-5]?\d),(STANDBY|OFF)", parameter):
                self._timer = (written[3], 60 * int(written[1]) + int(written[2]))  # the quick timer, number 0
            case "TIMER", "ON,0":
                self.timer_ends_s = now_s + 60.0 * self._timer[1]
            case "TIMER", "OFF,0":
                self.timer_ends_s = None
            case _:
                raise Refusal("PARA ERR")
        return self.acknowledgement.format(request, self._address or 1, command, command.lower())

    def _set_temperatures(self, parameter: str) -> None:
        """`S25`, `H80.0`, `L-45.0`, or several of them, judged together."""
        if not _TARGETS.fullmatch(parameter):
            raise Refusal("PARA ERR")
        asked = {letter: self._taken(float(value)) for letter, value in _TARGET.findall(parameter)}
        setpoint = asked.get("S", self.setpoint_degC)
        limits = ChamberLimits(asked.get("L", self.limits.low_degC), asked.get("H", self.limits.high_degC))
        in_order = (self._hardware.low_degC, limits.low_degC, setpoint, limits.high_degC, self._hardware.high_degC)
        if list(in_order) != sorted(in_order):
            raise Refusal("DATA OUT OF RANGE")
        self.setpoint_degC, self.limits = setpoint, limits

    def _set_program(self, parameter: str) -> None:
        """Start or end a program; it holds the present setpoint, which is enough to be in its way."""
        if re.fullmatch(r"RUN,(RAM|ROM):\d+,STEP\d+", parameter):
            self.mode = "RUN"
            return
        ended = re.fullmatch(r"END,(\w+)", parameter)
        if ended is None or ended[1] not in _PROGRAM_ENDS:
            raise Refusal("PARA ERR")
        if self.mode != "RUN":
            raise Refusal("CONT NOT READY-2")
        self.mode = _PROGRAM_ENDS[ended[1]]
