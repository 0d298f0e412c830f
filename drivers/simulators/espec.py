r"""An ESPEC ASCII controller with a chamber behind it, byte for byte, and with faults in front of it.

    plant = ChamberPlant()
    device = SimulatedEspec(plant, alarm_limits=ChamberLimits(-75.0, 105.0))
    device.receive(b"TEMP?\r\n", now_s=0.0)
    device.transmit(now_s=0.1)            # b"22.0,23.0,105.0,-75.0\r\n"

Independent of the driver: it formats and judges by itself. As real ones do, it ignores a request that comes before
the vendor's pause (0.3 s after a monitor command, 0.5 s after a setting), refuses a setpoint beyond its alarm limits,
and forgets its setpoint with its power. Byte-exact from sources: `TEMP?`, `TYPE?`, `HUMI?`, `MON?`, `CONSTANT
SET?,TEMP`, the `OK` spellings, `CMD ERR`, `DATA OUT OF RANGE`, `INVALID REQ`. Inferred: that an alarm stops the chamber
to STANDBY, that crossing an alarm limit raises code 1, that an alarm limit which would exclude the setpoint is
refused, and that a request coming too early is dropped without a word.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

from drivers.chamber import ChamberLimits
from drivers.simulators.chamber_plant import ChamberPlant

_PAUSE_AFTER_MONITOR_S = 0.3
_PAUSE_AFTER_SETTING_S = 0.5
_PACING_TOLERANCE_S = 0.01
_FACTORY_SETPOINT_DEGC = 23.0
_LIMIT_ALARM = "1"
_MONITORS = ("TEMP?", "MON?", "MODE?", "ALARM?", "CONSTANT SET?", "ROM?", "TYPE?", "HUMI?")
_TARGETS = re.compile(r"(?:[SHL]-?\d+(?:\.\d+)?(?:\s+|$))+")
_TARGET = re.compile(r"([SHL])(-?\d+(?:\.\d+)?)")


class FaultKind(StrEnum):
    """What can be wrong with a simulated controller."""

    # Of one request and its reply:
    DEAF = "deaf"  # the request is lost: nothing is done, nothing is answered
    SILENCE = "silence"  # the request is carried out, the reply is lost
    GARBAGE = "garbage"  # carried out, the reply is noise
    TRUNCATED = "truncated"  # carried out, the reply breaks off
    LATE = "late"  # carried out, the reply comes `delay_s` late: perhaps after the next request
    REFUSED = "refused"  # not carried out, `NA:` and `text`
    # Of the chamber, from a moment on:
    ALARM = "alarm"  # code `text`; the chamber stops
    PANEL_LOCK = "panel_lock"
    POWER_CYCLE = "power_cycle"  # comes back in mode OFF, its setpoint forgotten
    SENSOR_FROZEN = "sensor_frozen"
    SENSOR_BROKEN = "sensor_broken"  # reads `text`
    FAHRENHEIT = "fahrenheit"  # somebody switches the panel to °F; nothing on the line says so
    PROGRAM = "program"  # somebody starts a program at the panel
    PLANT_DEAD = "plant_dead"  # takes setpoints and does not follow them


_OF_A_REPLY = frozenset(
    {FaultKind.DEAF, FaultKind.SILENCE, FaultKind.GARBAGE, FaultKind.TRUNCATED, FaultKind.LATE, FaultKind.REFUSED}
)
_DEFAULT_TEXT = {
    FaultKind.GARBAGE: "\x00\x7f\xfe#~",
    FaultKind.REFUSED: "CMD ERR",
    FaultKind.ALARM: "19",
    FaultKind.SENSOR_BROKEN: "-199.9",
}


@dataclass(frozen=True)
class EspecFault:
    """One thing that goes wrong from `begins_s` on.

    A fault of a reply strikes `times` requests (None: all) that begin with `command` ("" for any). `text` is the noise,
    the error text, the alarm code or the broken reading; each kind has its own default.
    """

    kind: FaultKind
    begins_s: float = 0.0
    command: str = ""
    times: int | None = 1
    delay_s: float = 3.0
    text: str | None = None

    @property
    def said(self) -> str:
        """The text, or the kind's default."""
        return _DEFAULT_TEXT.get(self.kind, "") if self.text is None else self.text


class _Refusal(Exception):
    """The controller answers `NA:` and this text."""


class SimulatedEspec:
    """A `SimulatedDevice`: the controller of one chamber.

    `model` is the reply to `ROM?` and says by default that it is simulated; `type_text` the reply to `TYPE?`;
    `humidity` the reply to `HUMI?`, None for a chamber without. `alarm_limits` are as the last user left them,
    `setpoint_degC` and `mode` as well; `hardware_limits` bound what alarms can be set to. `spelling` is the form of
    `OK`: plain `OK:TEMP,S25`, addressed `OK:1,temp,s25`, manual `OK : 1,TEMP,S25`.
    """

    def __init__(
        self,
        plant: ChamberPlant,
        *,
        model: str = "P300 SIMULATED 1.00",
        type_text: str = "T,T,P3,180.0",
        alarm_limits: ChamberLimits = ChamberLimits(-75.0, 105.0),  # noqa: B008 - frozen
        hardware_limits: ChamberLimits = ChamberLimits(-80.0, 190.0),  # noqa: B008 - frozen
        setpoint_degC: float = _FACTORY_SETPOINT_DEGC,
        mode: Literal["OFF", "STANDBY", "CONSTANT", "RUN"] = "OFF",
        humidity: str | None = None,
        address: int | None = None,
        terminator: bytes = b"\r\n",
        latency_s: float = 0.05,
        spelling: Literal["plain", "addressed", "manual"] = "plain",
        faults: Iterable[EspecFault] = (),
        begins_s: float = 0.0,
    ) -> None:
        self.mode: str = mode
        self.setpoint_degC = setpoint_degC
        self.alarm_limits = alarm_limits
        self.alarms: tuple[str, ...] = ()
        self.panel_locked = False
        self.fahrenheit = False
        self.ignored_requests = 0  # came before the vendor's pause was over
        self._plant = plant
        self._model = model
        self._type_text = type_text
        self._hardware = hardware_limits
        self._humidity = humidity
        self._address = address
        self._terminator = terminator
        self._latency_s = latency_s
        self._spelling = spelling
        self._faults: list[EspecFault] = list(faults)
        self._line = b""
        self._pending: list[tuple[float, bytes]] = []
        self._ready_at_s = begins_s
        self._sensor: str | None = None
        self._condition(begins_s)

    def inject(self, fault: EspecFault) -> None:
        """Let one more thing go wrong."""
        self._faults.append(fault)

    def acknowledge_alarms(self) -> None:
        """Do what an operator does at the panel: clear the alarms. The chamber stays stopped."""
        self.alarms = ()

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the host; every complete line is a request."""
        self._suffer(now_s)
        self._watch_limits(now_s)
        self._line += data
        while self._terminator in self._line:
            line, self._line = self._line.split(self._terminator, 1)
            self._take(line, now_s)

    def transmit(self, now_s: float) -> bytes:
        """Return the replies that are due."""
        if not self._pending:
            return b""
        self._suffer(now_s)
        due = [reply for at_s, reply in self._pending if at_s <= now_s + 1e-9]
        self._pending = [(at_s, reply) for at_s, reply in self._pending if at_s > now_s + 1e-9]
        return b"".join(due)

    def next_transmission(self, now_s: float) -> float | None:
        """Return when the next reply is due, None where none is."""
        return max(now_s, min(at_s for at_s, _ in self._pending)) if self._pending else None

    def _take(self, line: bytes, now_s: float) -> None:
        """Answer one line, as far as pacing, address and faults let it."""
        if now_s < self._ready_at_s - _PACING_TOLERANCE_S:
            self.ignored_requests += 1
            return
        text = line.decode("ascii", errors="replace").strip()
        command = self._without_address(text)
        if command is None:
            return
        fault = self._strike(command, now_s)
        if fault is not None and fault.kind is FaultKind.DEAF:
            return
        is_monitor = "?" in command
        due_s = now_s + self._latency_s
        self._ready_at_s = due_s + (_PAUSE_AFTER_MONITOR_S if is_monitor else _PAUSE_AFTER_SETTING_S)
        try:
            if fault is not None and fault.kind is FaultKind.REFUSED:
                raise _Refusal(fault.said)
            reply = self._monitor(command, now_s) if is_monitor else self._setting(command, text, now_s)
        except _Refusal as refusal:
            reply = f"NA:{refusal}"
        self._answer(reply.encode("ascii") + self._terminator, due_s, fault)

    def _answer(self, reply: bytes, due_s: float, fault: EspecFault | None) -> None:
        """Put the reply on its way, damaged as `fault` says."""
        match fault.kind if fault else None:
            case FaultKind.SILENCE:
                return
            case FaultKind.GARBAGE if fault:
                reply = fault.said.encode("latin-1") + self._terminator
            case FaultKind.TRUNCATED:
                reply = reply[: max(1, len(reply) // 2)]
            case FaultKind.LATE if fault:
                due_s += fault.delay_s
        self._pending.append((due_s, reply))

    def _without_address(self, text: str) -> str | None:
        """Return the command, None where it is for another controller on the same line."""
        if self._address is None:
            return text
        addressed = re.match(r"(\d+)\s*,\s*(.*)", text)
        if addressed is None or int(addressed[1]) != self._address:
            return None
        return addressed[2]

    def _strike(self, command: str, now_s: float) -> EspecFault | None:
        """Return the fault of a reply that meets this request, and count it."""
        for number, fault in enumerate(self._faults):
            if fault.kind in _OF_A_REPLY and fault.begins_s <= now_s and command.startswith(fault.command):
                if fault.times is not None:
                    left = fault.times - 1
                    self._faults[number : number + 1] = [replace(fault, times=left)] if left else []
                return fault
        return None

    def _suffer(self, now_s: float) -> None:
        """Let the faults of the chamber happen whose time has come."""
        for fault in [each for each in self._faults if each.kind not in _OF_A_REPLY and each.begins_s <= now_s]:
            self._faults.remove(fault)
            self._happen(fault)

    def _watch_limits(self, now_s: float) -> None:
        """Raise the alarm of an air beyond the alarm limits, as seen whenever the host speaks."""
        if self.mode in ("CONSTANT", "RUN") and _LIMIT_ALARM not in self.alarms:
            air = self._plant.advance(now_s)
            if not self.alarm_limits.low_degC <= air <= self.alarm_limits.high_degC:
                self._raise_alarm(_LIMIT_ALARM, now_s)

    def _happen(self, fault: EspecFault) -> None:
        match fault.kind:
            case FaultKind.ALARM:
                self._raise_alarm(fault.said, fault.begins_s)
            case FaultKind.PANEL_LOCK:
                self.panel_locked = True
            case FaultKind.POWER_CYCLE:
                self.mode, self.setpoint_degC, self.alarms = "OFF", _FACTORY_SETPOINT_DEGC, ()
                self._line, self._pending = b"", []
                self._condition(fault.begins_s)
            case FaultKind.FAHRENHEIT:
                self.fahrenheit = True
            case FaultKind.PROGRAM:
                self.mode = "RUN"
                self._condition(fault.begins_s)
            case FaultKind.SENSOR_FROZEN:
                self._sensor = f"{self._plant.advance(fault.begins_s):.1f}"
            case FaultKind.SENSOR_BROKEN:
                self._sensor = fault.said
            case _:
                self._plant.kill(fault.begins_s)

    def _raise_alarm(self, code: str, at_s: float) -> None:
        self.alarms = (*self.alarms, code)
        if self.mode != "OFF":
            self.mode = "STANDBY"
        self._condition(at_s)

    def _condition(self, at_s: float) -> None:
        """Tell the plant what mode and setpoint mean for it."""
        self._plant.command(self.setpoint_degC if self.mode in ("CONSTANT", "RUN") else None, at_s)

    def _air(self, now_s: float) -> str:
        return self._sensor if self._sensor is not None else self._shown(self._plant.advance(now_s))

    def _shown(self, degC: float) -> str:
        return f"{degC * 1.8 + 32.0 if self.fahrenheit else degC:.1f}"

    def _monitor(self, command: str, now_s: float) -> str:
        """Return the data that a monitor command asks for."""
        if command in ("MON?,DETAIL", "MODE?,DETAIL"):
            if not self._model.startswith("P3"):
                raise _Refusal("PARA ERR")
            command = command.removesuffix(",DETAIL")
        match command:
            case "TEMP?":
                limits = self.alarm_limits
                settings = (self.setpoint_degC, limits.high_degC, limits.low_degC)
                return ",".join((self._air(now_s), *(self._shown(each) for each in settings)))
            case "MON?":
                return f"{self._air(now_s)},{self._humidity_now()},{self.mode},{len(self.alarms)}"
            case "MODE?":
                return self.mode
            case "ALARM?":
                return ",".join((str(len(self.alarms)), *self.alarms))
            case "CONSTANT SET?,TEMP":
                return f"{self._shown(self.setpoint_degC)},ON"
            case "ROM?":
                return self._model
            case "TYPE?":
                return self._type_text
            case "HUMI?":
                return self._humidity_reply()
        raise _Refusal("PARA ERR" if command.split(",")[0] in _MONITORS else "CMD ERR")

    def _humidity_now(self) -> str:
        return "" if self._humidity is None else self._humidity.split(",", 1)[0]

    def _humidity_reply(self) -> str:
        if self._humidity is None:
            raise _Refusal("INVALID REQ")
        return self._humidity

    def _setting(self, command: str, request: str, now_s: float) -> str:
        """Carry out a setting and return its acknowledgement."""
        head, _, parameter = command.partition(",")
        settings: dict[str, Callable[[str], None]] = {
            "TEMP": self._set_temperatures,
            "MODE": self._set_mode,
            "POWER": self._set_power,
            "PRGM": self._set_program,
        }
        if head not in settings:
            raise _Refusal("CMD ERR")
        if self.panel_locked:
            raise _Refusal("PROTECT ON")
        settings[head](parameter.strip())
        self._condition(now_s)
        address = self._address or 1
        if self._spelling == "addressed":
            return f"OK:{address},{command.lower()}"
        return f"OK : {address},{command}" if self._spelling == "manual" else f"OK:{request}"

    def _set_temperatures(self, parameter: str) -> None:
        """`S25`, `H80.0`, `L-45.0`, or several of them, judged together."""
        if not _TARGETS.fullmatch(parameter):
            raise _Refusal("PARA ERR")
        asked = {letter: self._taken(float(value)) for letter, value in _TARGET.findall(parameter)}
        setpoint = asked.get("S", self.setpoint_degC)
        limits = ChamberLimits(asked.get("L", self.alarm_limits.low_degC), asked.get("H", self.alarm_limits.high_degC))
        in_order = (self._hardware.low_degC, limits.low_degC, setpoint, limits.high_degC, self._hardware.high_degC)
        if list(in_order) != sorted(in_order):
            raise _Refusal("DATA OUT OF RANGE")
        self.setpoint_degC, self.alarm_limits = setpoint, limits

    def _taken(self, value: float) -> float:
        return (value - 32.0) / 1.8 if self.fahrenheit else value

    def _set_mode(self, parameter: str) -> None:
        if parameter not in ("OFF", "STANDBY", "CONSTANT"):
            raise _Refusal("PARA ERR")
        self.mode = parameter

    def _set_power(self, parameter: str) -> None:
        if parameter not in ("ON", "OFF"):
            raise _Refusal("PARA ERR")
        if parameter == "OFF":
            self.mode = "OFF"
        elif self.mode == "OFF":
            self.mode = "STANDBY"

    def _set_program(self, parameter: str) -> None:
        """Start or end a program; it holds the present setpoint, which is enough to be in its way."""
        if re.fullmatch(r"RUN,(RAM|ROM):\d+,STEP\d+", parameter):
            self.mode = "RUN"
        elif ended := re.fullmatch(r"END,(STANDBY|OFF|CONSTANT)", parameter):
            if self.mode != "RUN":
                raise _Refusal("CONT NOT READY-2")
            self.mode = ended[1]
        else:
            raise _Refusal("PARA ERR")
