"""ESPEC ASCII controllers: P-300, P-200, SCP-220, GL (RS-232, RS-485, or a TCP port that carries the same lines).

    chamber = EspecChamber(transport, clock, limits=ChamberLimits(-35.0, 65.0), safe=SafeState("hold", 25.0))
    chamber.identify()
    chamber.prepare()
    chamber.set_temperature(-29.72)       # -29.7 on the wire, read back and compared

Verified byte-exact (recorded dialogs and vendors' examples, with CR LF): `TEMP?`, `TYPE?`, `MON?` with an address,
`TEMP,S…` and its acknowledgements, `MODE,CONSTANT`, the refusals `CMD ERR` and `DATA OUT OF RANGE`, and the order
`TEMP,S` - `POWER,ON` - `MODE,CONSTANT`. Request exact, reply inferred from the grammar: `ROM?`, `ALARM?`, `TEMP,H…`,
`TEMP,L…`, `MODE,STANDBY`, `MODE,OFF`, `POWER,ON`, `PRGM,END,STANDBY`. Inferred, to be watched on hardware: that
`TEMP?` tells the constant setpoint in every mode, and that a native limit that would exclude the setpoint is refused.
Pauses are the vendor's: 0.3 s after a monitor command, 0.5 s after a setting.

What is common to all chambers lies in `drivers.setpoint_checks` and `drivers.line_exchange`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from drivers.chamber import ChamberIdentity, ChamberLimits, ChamberReading, SafeState
from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceError, DeviceTimeout, ProtocolError, TransportError, WrongDevice
from drivers.espec_replies import ReplyParser, Status, Temperatures
from drivers.line_exchange import LineExchange, LineTiming
from drivers.setpoint_checks import (
    Settings,
    agrees,
    clamped,
    confirm_settings,
    limits_around,
    plausible_temperature,
    refuse_fahrenheit,
    representable_setpoint,
    writes_in_order,
)
from drivers.transport import Transport
from drivers.write_wear import WriteWear

Reply = TypeVar("Reply")

_RESOLUTION_DEGC = 0.1
_SETTING = {"low": "L", "setpoint": "S", "high": "H"}
_MODE_CHANGE_S = 1.0  # between two looks at a mode that has not changed yet


class EspecChamber:
    """A `Chamber` behind an ESPEC ASCII controller.

    `limits` bound what is ever sent as a setpoint; the controller's own high and low alarm are set
    `native_margin_degC` beyond them, so that overshoot does not trip them (and beyond the air while that is still
    outside). `expected_model` is how the reply to
    `ROM?` must begin (case does not matter), None for any. `address` is for RS-485 only. `celsius_confirmed` says
    that a person has seen °C on the panel: the protocol cannot tell, and otherwise a suspicious reading is refused.

    Raises `SetpointOutOfLimits` at once where the safe state would hold a temperature outside the limits.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        limits: ChamberLimits,
        safe: SafeState,
        expected_model: str | None = None,
        address: int | None = None,
        terminator: bytes = b"\r\n",
        timing: LineTiming | None = None,
        native_margin_degC: float = 5.0,
        celsius_confirmed: bool = False,
    ) -> None:
        if safe.temperature_degC is not None:
            representable_setpoint(safe.temperature_degC, limits, _RESOLUTION_DEGC)
        self._transport = transport
        self._clock = clock
        self._limits = limits
        self._native = ChamberLimits(
            round(limits.low_degC - native_margin_degC, 1), round(limits.high_degC + native_margin_degC, 1)
        )
        self._native_margin_degC = native_margin_degC
        self._safe = safe
        self._expected_model = expected_model
        self._prefix = "" if address is None else f"{address},"
        self._celsius_confirmed = celsius_confirmed
        self._timing = timing or LineTiming()
        self._device = f"chamber on {transport.name}"
        self._exchange = LineExchange(transport, clock, device=self._device, terminator=terminator, timing=self._timing)
        self._replies = ReplyParser(self._device)
        self._wear = WriteWear(clock)
        self._identity: ChamberIdentity | None = None

    @property
    def limits(self) -> ChamberLimits:
        """The limits given by the bench file."""
        return self._limits

    @property
    def wear_warning(self) -> str | None:
        """Say so where the controller's memory would be worn out within a year at this rate."""
        return self._wear.warning()

    def identify(self) -> ChamberIdentity:
        """Ask model and type, and look whether it can be speaking °C.

        Raises `WrongDevice` for another model or a suspicious unit. Nothing is written before this has passed.
        """
        self._identity = None
        try:
            model = self._query("ROM?", self._replies.text)
        except CommandRefused:
            model = ""  # the oldest controllers know TYPE? alone
        controller, maximum = self._query("TYPE?", self._replies.chamber_type)
        model = model or controller
        if self._expected_model is not None and not model.upper().startswith(self._expected_model.upper()):
            raise WrongDevice(
                f"{self._device} says it is {model!r}, the bench file expects {self._expected_model!r}; "
                "check the cable and the port, or correct the bench file"
            )
        status = self._status()
        if not self._celsius_confirmed:
            idle = status.mode in ("OFF", "STANDBY")
            refuse_fahrenheit(status.temperature_degC, idle=idle, chamber_maximum=maximum, device=self._device)
        self._identity = ChamberIdentity(model=model, unit="degC")
        return self._identity

    def prepare(self) -> None:
        """Set the native limits and start constant-temperature operation.

        A chamber that already holds a setpoint within the bench's limits keeps it; any other is started at its
        present temperature, so that a setpoint somebody forgot is never driven to. Raises `CommandRefused` where an
        alarm is active or a program is running: both are for a person to clear.
        """
        self._require_identity()
        reading = self.read()
        if reading.alarms:
            raise CommandRefused(
                f"{self._device} reports {', '.join(reading.alarms)}; clear the cause and acknowledge it at the panel"
            )
        if reading.mode not in ("OFF", "STANDBY", "CONSTANT"):
            raise CommandRefused(f"{self._device} is in mode {reading.mode}; end its program at the panel first")
        keeps = reading.mode == "CONSTANT" and (
            self._limits.low_degC <= reading.setpoint_degC <= self._limits.high_degC
        )
        start = reading.setpoint_degC if keeps else clamped(reading.temperature_degC, self._limits)
        self._settle_on(representable_setpoint(start, self._limits, _RESOLUTION_DEGC))
        if reading.mode != "CONSTANT":
            self._start_constant(power_is_off=reading.mode == "OFF")
        self._confirm_mode("CONSTANT", looks=self._timing.attempts)

    def read(self) -> ChamberReading:
        """Read temperature, setpoint, native limits, mode and alarms; alarms are reported, never acknowledged.

        Raises `SensorFault` where the temperature is one that only a broken sensor gives.
        """
        temperatures = self._query("TEMP?", self._plausible_temperatures)
        status = self._status()
        codes = self._query("ALARM?", self._replies.alarms) if status.alarms else ()
        alarms = tuple(f"alarm {code}" for code in codes)
        if status.alarms and not alarms:
            alarms = ("alarm without a code",)
        return ChamberReading(
            temperature_degC=temperatures.temperature_degC,
            setpoint_degC=temperatures.setpoint_degC,
            high_limit_degC=temperatures.high_degC,
            low_limit_degC=temperatures.low_degC,
            mode=status.mode,
            alarms=alarms,
        )

    def set_temperature(self, setpoint_degC: float) -> None:
        """Set, read back and compare the setpoint, in steps of 0.1 °C.

        Raises `SetpointOutOfLimits` before anything is sent, `ProtocolError` where another value is read back, and
        `CommandRefused` where the controller refuses or is not in constant-temperature mode (stopped at its panel, or
        power was lost): then `prepare` must come first.
        """
        wanted = representable_setpoint(setpoint_degC, self._limits, _RESOLUTION_DEGC)
        self._require_identity()
        self._settle_on(wanted)
        mode = self._status().mode
        if mode != "CONSTANT":
            raise CommandRefused(
                f"{self._device} took the setpoint but is in mode {mode}: it was stopped, or its power was lost; "
                "it must be prepared anew"
            )

    def safe_state(self) -> None:
        """Bring the chamber to the bench file's safe state, trying as often as a read is tried.

        May be called at any time, before `identify` and after any error. What already is safe is left alone. What
        counts is what is read at the end: refusals and lost replies on the way there do not matter. Raises the last
        `DeviceError`, saying that somebody must go there, where the state could not be confirmed.
        """
        attempts = self._timing.attempts
        for attempt in range(1, attempts + 1):
            try:
                self._reach_safe_state()
                return
            except DeviceError as error:
                if attempt == attempts:
                    raise type(error)(
                        f"the safe state ({self._safe_words()}) could not be confirmed in {attempts} attempts; go to "
                        f"the chamber and stop it at its panel: {error}"
                    ) from error
                self._clock.sleep(_MODE_CHANGE_S)

    def close(self) -> None:
        """Release the port; the chamber goes on as it is."""
        self._transport.close()

    def _safe_words(self) -> str:
        if self._safe.temperature_degC is None:
            return self._safe.action
        return f"{self._safe.action} at {self._safe.temperature_degC:g} °C"

    def _reach_safe_state(self) -> None:
        """Write whatever is missing to the safe state, then insist on reading it."""
        problem = self._unsafe(looks=1)
        if problem is None:
            return
        # A chamber that does not answer may still hear: everything is sent, and nothing more asked until the end.
        silent = isinstance(problem, DeviceTimeout)
        refused: list[DeviceError] = []
        for action in self._safe_actions(None if silent else self._mode_or_none(), silent=silent):
            try:
                action()
            except TransportError:
                raise
            except DeviceError as error:
                refused.append(error)
        problem = self._unsafe(looks=self._timing.attempts)
        if problem is not None:
            raise (refused or [problem])[0]

    def _safe_actions(self, mode: str | None, *, silent: bool) -> list[Callable[[], None]]:
        """Return what leads from `mode` (None: it could not be read) to the safe state."""
        actions: list[Callable[[], None]] = []
        if mode not in ("OFF", "STANDBY", "CONSTANT"):
            actions.append(lambda: self._command("PRGM,END,STANDBY"))
        if self._safe.action == "standby":
            return [*actions, lambda: self._command("MODE,STANDBY")]
        if self._safe.action == "off":
            return [*actions, lambda: self._command("MODE,OFF")]
        actions.append(lambda: self._set_safe_temperature(silent=silent))
        if mode != "CONSTANT":
            actions.append(lambda: self._start_constant(power_is_off=mode in ("OFF", None)))
        return actions

    def _set_safe_temperature(self, *, silent: bool) -> None:
        setpoint = self._safe_setpoint()
        if not silent:
            try:
                self._settle_on(setpoint)
                return
            except TransportError:
                raise
            except DeviceError:
                # The native limits could not be had: the setpoint alone matters now.
                pass
        self._write("setpoint", setpoint)

    def _write(self, which: str, value_degC: float) -> None:
        self._wear.note(which if which == "setpoint" else f"{which} limit")
        self._command(f"TEMP,{_SETTING[which]}{value_degC:.1f}")

    def _safe_setpoint(self) -> float:
        if self._safe.temperature_degC is None:
            raise ValueError("this safe state holds no temperature")
        return representable_setpoint(self._safe.temperature_degC, self._limits, _RESOLUTION_DEGC)

    def _unsafe(self, *, looks: int) -> DeviceError | None:
        """Return why the chamber is not in its safe state, or None where it is."""
        try:
            if self._safe.action == "hold":
                setpoint = self._temperatures().setpoint_degC
                if not agrees(setpoint, self._safe_setpoint(), _RESOLUTION_DEGC):
                    return ProtocolError(f"{self._device} has setpoint {setpoint:g} °C")
                self._confirm_mode("CONSTANT", looks=looks)
            elif self._safe.action == "standby":
                self._confirm_mode("STANDBY", "OFF", looks=looks)
            else:
                self._confirm_mode("OFF", looks=looks)
        except TransportError:
            raise
        except DeviceError as error:
            return error
        return None

    def _mode_or_none(self) -> str | None:
        try:
            return self._status().mode
        except TransportError:
            raise
        except DeviceError:
            return None

    def _require_identity(self) -> None:
        if self._identity is None:
            self.identify()

    def _settle_on(self, setpoint_degC: float) -> None:
        """Write setpoint and native limits in the order that the controller accepts, and read all of them back."""
        present = self._temperatures()
        limits = limits_around(self._native, present.temperature_degC, self._native_margin_degC)
        wanted = Settings(limits.low_degC, setpoint_degC, limits.high_degC)
        for write in writes_in_order(_settings_of(present), wanted, _RESOLUTION_DEGC):
            self._write(write.which, write.value_degC)
        for look in range(1, self._timing.attempts + 1):
            try:
                confirm_settings(_settings_of(self._temperatures()), wanted, _RESOLUTION_DEGC, self._device)
                return
            except ProtocolError:
                # A late reply to the question before the writes still shows the old values: ask once more.
                if look == self._timing.attempts:
                    raise

    def _start_constant(self, *, power_is_off: bool) -> None:
        """Start constant-temperature operation; the caller looks whether it did."""
        if power_is_off:
            with suppress(CommandRefused):  # controllers without this command start with the mode alone
                self._command("POWER,ON")
        self._command("MODE,CONSTANT")

    def _confirm_mode(self, *modes: str, looks: int) -> None:
        """Look at most `looks` times whether the controller is in one of `modes`; raise `ProtocolError`."""
        mode = self._status().mode
        for _ in range(looks - 1):
            if mode in modes:
                return
            self._clock.sleep(_MODE_CHANGE_S)
            mode = self._status().mode
        if mode not in modes:
            raise ProtocolError(f"{self._device} is in mode {mode} and not in {' or '.join(modes)}")

    def _command(self, command: str) -> None:
        """Send a setting once. A lost acknowledgement is no error here: every caller reads back what it set."""
        request = self._prefix + command
        self._exchange.command(request, lambda line: self._replies.acknowledged(request, line))

    def _query(self, command: str, parse: Callable[[str, str], Reply]) -> Reply:
        request = self._prefix + command
        return self._exchange.query(request, lambda line: parse(request, line))

    def _plausible_temperatures(self, request: str, line: str) -> Temperatures:
        reply = self._replies.temperatures(request, line)
        plausible_temperature(reply.temperature_degC, self._device)
        return reply

    def _temperatures(self) -> Temperatures:
        return self._query("TEMP?", self._replies.temperatures)

    def _status(self) -> Status:
        return self._query("MON?", self._replies.status)


def _settings_of(reply: Temperatures) -> Settings:
    return Settings(reply.low_degC, reply.setpoint_degC, reply.high_degC)
