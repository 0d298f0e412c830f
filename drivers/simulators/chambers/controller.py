"""What all simulated chamber controllers share: the air, the state, the faults, and replies that are on their way.

A protocol's simulator cuts requests out of the bytes (`_next_request`), says what they are called (`_name`), carries
them out (`_carry_out`) and knows how to refuse (`_refused`). It formats and judges by itself, without the driver.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, field, replace
from enum import StrEnum
from typing import Any

from drivers.chambers import ChamberLimits
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.transports.framing import Framings

_PACING_TOLERANCE_S = 0.01
FACTORY_SETPOINT_DEGC = 23.0


class ChamberFaultKind(StrEnum):
    """What can be wrong with a simulated controller."""

    # Of one request and its reply:
    DEAF = "deaf"  # the request is lost: nothing is done, nothing is answered
    SILENCE = "silence"  # the request is carried out, the reply is lost
    GARBAGE = "garbage"  # carried out, the reply is noise
    TRUNCATED = "truncated"  # carried out, the reply breaks off
    CORRUPTED = "corrupted"  # carried out, one bit of the reply is wrong (and with it its checksum, where it has one)
    LATE = "late"  # carried out, the reply comes `delay_s` late: perhaps after the next request
    REFUSED = "refused"  # not carried out: the protocol's refusal
    # Of the chamber, from a moment on:
    ALARM = "alarm"  # the chamber stops
    PANEL_LOCK = "panel_lock"  # what is written is refused
    POWER_CYCLE = "power_cycle"  # comes back stopped, its setpoint forgotten
    FAHRENHEIT = "fahrenheit"  # somebody switches the panel to °F
    PROGRAM = "program"  # somebody starts a program at the panel
    SENSOR_FROZEN = "sensor_frozen"
    SENSOR_BROKEN = "sensor_broken"  # reads `reading`
    RUNAWAY = "runaway"  # conditions, but `astray_degC` beyond its setpoint
    PLANT_DEAD = "plant_dead"  # takes setpoints and does not follow them
    NOT_CARRIED_OUT = "not_carried_out"  # acknowledges and shows what it is told, and goes on as it was


Kind = ChamberFaultKind
OF_A_REPLY = {Kind.DEAF, Kind.SILENCE, Kind.GARBAGE, Kind.TRUNCATED, Kind.CORRUPTED, Kind.LATE, Kind.REFUSED}


@dataclass(frozen=True)
class ChamberFault:
    """One thing that goes wrong from `begins_s` on, until `ends_s` at the latest.

    A fault of a reply strikes `times` requests (None: all) whose name begins with `command` ("" for any). `reading` is
    what a broken sensor reads. `text` is a protocol's own word for a refusal or an alarm, None for its usual one. What
    a power cycle has made the controller forget, and a program that was started, do not come back at the end.
    """

    kind: ChamberFaultKind
    begins_s: float = 0.0
    command: str = ""
    times: int | None = 1
    delay_s: float = 3.0
    reading: float = -199.9
    text: str | None = None
    ends_s: float = math.inf
    astray_degC: float = 60.0


class Refusal(Exception):
    """The controller will not; the text is the protocol's own word or number."""


@dataclass(eq=False)
class SimulatedController(ABC):
    """The part of a `SimulatedDevice` that every simulated controller has.

    `setpoint_degC`, `limits` and `mode` are as the last user left them. Times are seconds on the caller's clock. A
    request that comes sooner than `pause_s` after the last reply is ignored, and counted.
    """

    plant: ChamberPlant
    _: KW_ONLY
    setpoint_degC: float = FACTORY_SETPOINT_DEGC
    limits: ChamberLimits = ChamberLimits(-75.0, 185.0)  # noqa: RUF009 - frozen
    mode: str = "OFF"
    latency_s: float = 0.05
    pause_s: float = 0.0
    faults: Iterable[ChamberFault] = ()
    begins_s: float = 0.0
    alarms: tuple[str, ...] = field(default=(), init=False)
    _sensor_degC: float | None = field(default=None, init=False)
    _usual_alarm = "1"  # where a fault names none
    _stopped = "OFF"  # the mode in which an alarm leaves it
    panel_locked = fahrenheit = False
    ignored_requests = 0
    _received = b""
    _obeyed = True

    def __post_init__(self) -> None:
        self._faults = list(self.faults)
        self._going_on: list[ChamberFault] = []  # have happened, and will end
        self._pending: list[tuple[float, bytes]] = []
        self._ready_at_s = self.begins_s
        self._condition(self.begins_s)

    def inject(self, fault: ChamberFault) -> None:
        """Let one more thing go wrong."""
        self._faults.append(fault)

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the host; every complete request is carried out."""
        self._suffer(now_s)
        self._received += data
        while (request := self._next_request()) is not None:
            self._take(request, now_s)

    def transmit(self, now_s: float) -> bytes:
        if not self._pending:
            return b""
        self._suffer(now_s)
        due = [reply for at_s, reply in self._pending if at_s <= now_s + 1e-9]
        self._pending = [(at_s, reply) for at_s, reply in self._pending if at_s > now_s + 1e-9]
        return b"".join(due)

    def next_transmission(self, now_s: float) -> float | None:
        return max(now_s, min(at_s for at_s, _ in self._pending)) if self._pending else None

    # What a protocol says.

    @abstractmethod
    def _next_request(self) -> bytes | None:
        """Cut one complete request off what was received, None where there is none."""

    @abstractmethod
    def _name(self, request: bytes) -> str:
        """Return what faults call this request."""

    @abstractmethod
    def _carry_out(self, request: bytes, now_s: float) -> bytes:
        """Do what a request asks and return the reply, nothing where there is none; raise `Refusal`."""

    @abstractmethod
    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        """Return the reply to a request that was refused."""

    def _refusal(self) -> str:
        """Return the protocol's usual word for a refusal."""
        return ""

    def _pause_after(self, request: bytes) -> float:
        """Return how long it wants to be left alone after its reply to this request, or after what has none, s."""
        return self.pause_s

    def _power_up(self) -> None:  # noqa: B027 - most protocols forget nothing of their own
        """Forget what the protocol's own part forgets with its power."""

    # What is common.

    def _take(self, request: bytes, now_s: float) -> None:
        if now_s < self._ready_at_s - _PACING_TOLERANCE_S:
            self.ignored_requests += 1
            return
        fault = self._strike(self._name(request), now_s)
        if fault is not None and fault.kind is Kind.DEAF:
            return
        due_s = now_s + self.latency_s
        pause_s = self._pause_after(request)
        try:
            if fault is not None and fault.kind is Kind.REFUSED:
                raise Refusal(self._refusal() if fault.text is None else fault.text)
            reply = self._carry_out(request, now_s)
        except Refusal as refusal:
            reply = self._refused(request, refusal)
        self._ready_at_s = (due_s if reply else now_s) + pause_s if pause_s else now_s
        self._condition(now_s)
        self._answer(reply, due_s, fault)

    def _answer(self, reply: bytes, due_s: float, fault: ChamberFault | None) -> None:
        if not reply:
            return
        match fault.kind if fault else None:
            case Kind.SILENCE:
                return
            case Kind.GARBAGE:
                reply = self._noise()
            case Kind.TRUNCATED:
                reply = reply[: max(1, len(reply) // 2)]
            case Kind.CORRUPTED:
                place = min(3, len(reply) - 1)
                reply = reply[:place] + bytes([reply[place] ^ 0x40]) + reply[place + 1 :]
            case Kind.LATE if fault:
                due_s += fault.delay_s
        self._pending.append((due_s, reply))

    def _noise(self) -> bytes:
        """Return a burst of noise, with what ends a reply so that it is taken for one."""
        return b"\x00\x7f\xfe#~"

    def _strike(self, name: str, now_s: float) -> ChamberFault | None:
        for number, fault in enumerate(self._faults):
            in_time = fault.begins_s <= now_s < fault.ends_s
            if fault.kind in OF_A_REPLY and in_time and name.startswith(fault.command):
                if fault.times is not None:
                    left = fault.times - 1
                    self._faults[number : number + 1] = [replace(fault, times=left)] if left > 0 else []
                return fault
        return None

    def _suffer(self, now_s: float) -> None:
        due = [each for each in self._faults if each.kind not in OF_A_REPLY and each.begins_s <= now_s]
        for fault in sorted(due, key=lambda each: each.begins_s):
            self._faults.remove(fault)
            self._turn(fault, on=True)
            self._going_on.append(fault)
        for fault in [each for each in self._going_on if each.ends_s <= now_s]:
            self._going_on.remove(fault)
            self._turn(fault, on=False)

    def _turn(self, fault: ChamberFault, *, on: bool) -> None:
        """Let a fault of the chamber begin or be over. What was forgotten stays forgotten."""
        at_s = fault.begins_s if on else fault.ends_s
        match fault.kind:
            case Kind.ALARM if on:
                self.alarms = (*self.alarms, fault.text or self._usual_alarm)
                self.mode = self._stopped if self.mode != "OFF" else "OFF"
            case Kind.ALARM:
                self.alarms = ()
            case Kind.PANEL_LOCK:
                self.panel_locked = on
            case Kind.POWER_CYCLE if on:
                self.mode, self.setpoint_degC, self.alarms = "OFF", FACTORY_SETPOINT_DEGC, ()
                self._received, self._pending = b"", []
                self._power_up()
            case Kind.FAHRENHEIT:
                self.fahrenheit = on
            case Kind.PROGRAM if on and not self._dark(at_s):
                self.mode = "RUN"
            case Kind.SENSOR_FROZEN:
                self._sensor_degC = self.plant.advance(at_s) if on else None
            case Kind.SENSOR_BROKEN:
                self._sensor_degC = fault.reading if on else None
            case Kind.RUNAWAY:
                self.plant.go_astray(fault.astray_degC if on else 0.0, at_s)
            case Kind.NOT_CARRIED_OUT:
                self._obeyed = not on
            case Kind.PLANT_DEAD:
                self.plant.fail(dead=on, at_s=at_s)
        self._condition(at_s)

    def _dark(self, at_s: float) -> bool:
        """Tell whether its power is gone at that time: nobody starts anything at a panel that is dark."""
        gone = [each for each in self._going_on if each.kind is Kind.POWER_CYCLE]
        return any(each.begins_s <= at_s < each.ends_s < math.inf for each in gone)

    def _condition(self, at_s: float) -> None:
        if self._obeyed:
            self.plant.command(self.setpoint_degC if self.mode in ("CONSTANT", "RUN") else None, at_s)

    def _air(self, now_s: float) -> float:
        """Return the sensor's temperature in the unit of the panel."""
        return self._shown(self.plant.advance(now_s) if self._sensor_degC is None else self._sensor_degC)

    def _shown(self, degC: float) -> float:
        return degC * 1.8 + 32.0 if self.fahrenheit else degC

    def _taken(self, value: float) -> float:
        return (value - 32.0) / 1.8 if self.fahrenheit else value

    def _refuse_if_locked(self) -> None:
        if self.panel_locked:
            raise Refusal(self._refusal())


class SimulatedLines(SimulatedController):
    """A `SimulatedDevice` that answers text with text (`_respond`). Faults know requests by their text."""

    def __init__(self, plant: ChamberPlant, framings: Framings, **settings: Any) -> None:
        self._framings = framings
        super().__init__(plant, **settings)

    @abstractmethod
    def _respond(self, request: str, now_s: float) -> str | None:
        """Return the reply to a request, None for silence; raise `Refusal`."""

    def _next_request(self) -> bytes | None:
        try:
            # Of what is told and what is asked the first to end; its check may look like the end of a question.
            both = [each.cut(self._received) for each in (self._framings.told, self._framings.asked)]
            found = max((each for each in both if each is not None), key=lambda each: len(each[1]), default=None)
        except ValueError:  # a damaged frame is not answered
            self._received = b""
            return None
        if found is None:
            return None
        text, self._received = found
        return text

    def _name(self, request: bytes) -> str:
        return request.decode(self._framings.encoding, errors="replace")

    def _carry_out(self, request: bytes, now_s: float) -> bytes:
        return self._line(self._respond(self._name(request), now_s))

    def _refused(self, request: bytes, refusal: Refusal) -> bytes:
        return b""

    def _line(self, reply: str | None) -> bytes:
        return b"" if reply is None else self._framings.replied.packed(reply.encode(self._framings.encoding))

    def _noise(self) -> bytes:
        return self._framings.replied.packed(super()._noise())
