"""The chamber that procedures see, over any `Controller`: what every driver must do, done once.

    asks = Supervision(ChamberLimits(-35.0, 65.0), SafeState("hold", 25.0))
    chamber = SupervisedChamber(SetpointBox(transport, clock, box), clock, asks)
    chamber.prepare()
    chamber.set_temperature(-29.72)       # -29.7 on the wire, read back and compared

Model and unit are confirmed before anything is written, and the unit again with every setpoint. Setpoints are checked
against the bench's limits before and after rounding. Native limits are written in the order that never excludes the
setpoint. Writes are sent once, counted, and read back. Alarms are polled and latched: once seen they stay in every
reading until the chamber is prepared anew with none standing; nothing that is sent acknowledges one. Readings that
cannot be true are a `SensorFault`. The safe state is confirmed by reading it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeVar

from drivers.chambers.chamber import ChamberIdentity, ChamberLimits, ChamberReading, SafeState
from drivers.chambers.controller import Controller, ControllerState, Which
from drivers.chambers.guards import DeadMan, ReadingWatch, WriteWear
from drivers.chambers.setpoints import (
    NativeLimits,
    agrees,
    clamped,
    confirm_settings,
    reads_as_fahrenheit,
    refuse_fahrenheit,
    representable_setpoint,
    writes_in_order,
)
from drivers.clock import Clock
from drivers.errors import (
    CommandRefused,
    DeviceError,
    DeviceTimeout,
    ProtocolError,
    SensorFault,
    TransportError,
    WrongDevice,
)
from drivers.transports.transport import ATTEMPTS

_OPERATION_S = 90.0  # of looking, one look more at most
_SAFE_STATE_S = 90.0  # after which the safe state is not tried anew: whoever called must hear of it
_MODE_CHANGE_S = 1.0  # between two looks at a mode that has not changed yet
Result = TypeVar("Result")


@dataclass(frozen=True)
class Supervision:
    """What a bench file asks of its chamber, whatever that speaks.

    `limits` bound what is ever sent as a setpoint; native limits are set `native_margin_degC` beyond them. The model
    that answers must begin with `expected_model` (case does not matter; None for any). `celsius_confirmed` says that a
    person has seen °C on the panel, for controllers that cannot tell their unit. `dead_man_s` arms the controller's own
    timer with `prepare`, which stops the chamber when it has been left alone for so long; readings and settings renew
    it until the safe state is asked for. The controller need not have one unless `dead_man_asked`.
    """

    limits: ChamberLimits
    safe: SafeState
    expected_model: str | None = None
    native_margin_degC: float = 5.0
    celsius_confirmed: bool = False
    dead_man_s: float | None = None
    dead_man_asked: bool = True


class SupervisedChamber:
    """A `Chamber` over a controller. `wear` counts how often setpoint and native limits are written.

    Raises `SetpointOutOfLimits` at once where the safe state would hold a temperature outside the limits, and
    `ValueError` where it would stop a controller that cannot be stopped over the line.
    """

    def __init__(self, controller: Controller, clock: Clock, asks: Supervision) -> None:
        self._controller, self._clock, self._asks = controller, clock, asks
        self.limits: Final = asks.limits
        if asks.safe.temperature_degC is not None:
            self._representable(asks.safe.temperature_degC)
        elif not controller.can_stop:
            raise ValueError("this controller cannot be stopped over the line; give a safe state that holds")
        self._dead_man = DeadMan(controller, clock, asks.dead_man_s, asks.dead_man_asked)
        self._native = NativeLimits(controller, asks.limits, asks.native_margin_degC)
        self._device = controller.device
        self._watch = ReadingWatch(self._device)
        self.wear = WriteWear(clock)
        self._latched: tuple[str, ...] = ()
        self._confirmed: float | None = None  # the setpoint last read back
        self._give_up_s = math.inf
        self._switched = False  # to °F, seen by its setpoint
        self._identity: ChamberIdentity | None = None

    @property
    def wear_warning(self) -> str | None:
        return self.wear.warning()

    def identify(self) -> ChamberIdentity:
        """Ask model and unit; raise `WrongDevice` for another model, for °F, and for a suspicious unit."""
        self._identity, self._switched = None, False
        found = self._controller.identify()
        if not self._is_expected(found.model):
            found = self._controller.identify()  # on a line without checksums the name may have been damaged
        if not self._is_expected(found.model):
            raise WrongDevice(
                f"{self._device} says it is {found.model!r}, the bench file expects {self._asks.expected_model!r}; "
                "check the cable and the port, or correct the bench file"
            )
        self._refuse_unit(found.unit)
        if found.unit is None and not self._asks.celsius_confirmed:
            state = self._controller.state()
            idle = state.mode in ("OFF", "STANDBY")
            refuse_fahrenheit(state.temperature, idle=idle, chamber_maximum=found.maximum, device=self._device)
        self._identity = ChamberIdentity(model=found.model, unit="degC")
        return self._identity

    def prepare(self) -> None:
        """Set the native limits and start constant-temperature operation.

        A chamber that already holds a setpoint within the bench's limits keeps it; any other is started at its
        present temperature, so that a setpoint somebody forgot is never driven to. Raises `CommandRefused` where an
        alarm stands or a program is running: both are for a person to clear.
        """
        self._require_identity()
        self._begin()
        self._watch.forget()
        state = self._believable()
        if state.alarms:
            self._latch(state.alarms)
            raise CommandRefused(
                f"{self._device} reports {', '.join(state.alarms)}; clear the cause and acknowledge it at the panel"
            )
        if state.mode == "RUN":
            raise CommandRefused(f"{self._device} is running a program; end it at the panel first")
        keeps = state.mode == "CONSTANT" and self.limits.low_degC <= state.setpoint <= self.limits.high_degC
        start = state.setpoint if keeps else clamped(state.temperature, self.limits)
        self._dead_man.arm()
        self._settle_on(self._representable(start))
        if state.mode != "CONSTANT":
            self._controller.start()
        self._confirm_mode("CONSTANT", looks=ATTEMPTS)
        self._latched = ()

    def read(self) -> ChamberReading:
        """Read temperature, setpoint, native limits (infinite where there are none), mode and alarms, standing or seen.

        Raises `SensorFault` where the temperature cannot be true, and `WrongDevice` where the unit is no longer °C.
        """
        self._begin()
        state = self._believable()
        self._latch(state.alarms)
        self._dead_man.renew()
        return ChamberReading(
            temperature_degC=state.temperature,
            setpoint_degC=state.setpoint,
            high_limit_degC=math.inf if state.high is None else state.high,
            low_limit_degC=-math.inf if state.low is None else state.low,
            mode=state.mode,
            alarms=self._latched,
        )

    def set_temperature(self, setpoint_degC: float) -> None:
        """Set, read back and compare the setpoint, in the controller's steps.

        Raises `SetpointOutOfLimits` before anything is sent, `ProtocolError` where another value is read back, and
        `CommandRefused` where the controller refuses or does not condition to its setpoint (stopped at its panel,
        power lost, a program running): then `prepare` must come first.
        """
        wanted = self._representable(setpoint_degC)
        self._require_identity()
        self._begin()
        self._dead_man.renew()
        mode = self._settle_on(wanted).mode
        if mode != "CONSTANT":
            raise CommandRefused(
                f"{self._device} took the setpoint but is in mode {mode}: it was stopped, runs a program, or its "
                "power was lost; it must be prepared anew"
            )

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Let the controller bound its ramp; return False where it cannot and the host must step the setpoint."""
        self._require_identity()
        return self._controller.set_ramp_rate(degC_per_min)

    def safe_state(self) -> SafeState:
        """Bring the chamber to the bench file's safe state, trying as often as a read is tried.

        May be called at any time, before `identify` and after any error. What already is safe is left alone. What
        counts is what is read at the end. Raises the last `DeviceError` where that is not safe: somebody must go there.
        """
        self._dead_man.rest()
        self._begin()
        give_up_s = self._clock.now() + _SAFE_STATE_S
        attempt = 0
        while True:
            attempt += 1
            try:
                self._reach_safe_state()
                return self._asks.safe
            except DeviceError as error:
                if attempt == ATTEMPTS or self._clock.now() >= give_up_s:
                    tried = f"{attempt} attempt{'s' * (attempt > 1)}"
                    raise type(error)(
                        f"the safe state ({self._asks.safe.words}) could not be confirmed in {tried}; go to "
                        f"the chamber and stop it at its panel: {error}"
                    ) from error
                self._clock.sleep(_MODE_CHANGE_S)

    def close(self) -> None:
        self._controller.close()

    def _believable(self) -> ControllerState:
        """Look until the temperature can be true, a bounded number of times: one glitch must not end a night."""
        left = ATTEMPTS
        while True:
            left -= 1
            state = self._state()
            driven_to = state.setpoint if state.mode == "CONSTANT" else None
            try:
                self._watch.accept(self._clock.now(), state.temperature, driven_to_degC=driven_to)
                return state
            except SensorFault:
                if not left:
                    raise

    def _begin(self) -> None:
        self._give_up_s = self._clock.now() + _OPERATION_S

    def _look(self) -> ControllerState:
        if self._clock.now() > self._give_up_s:
            raise DeviceTimeout(
                f"{self._device} answers so late that {_OPERATION_S:g} s were not enough; check the line, and who else "
                "uses it"
            )
        return self._controller.state()

    def _state(self) -> ControllerState:
        state = self._look()
        self._refuse_unit(self._unit_of(state))
        return state

    def _unit_of(self, state: ControllerState) -> str | None:
        """Return the unit that a state is in, as the controller or its setpoint tells it; None where neither does."""
        if state.unit is not None:
            return state.unit
        resolution = self._controller.resolution_degC
        if self._confirmed is not None and reads_as_fahrenheit(state.setpoint, self._confirmed, resolution):
            self._switched = True  # until somebody identifies it anew: what the safe state writes hides it
        return "degF" if self._switched else None

    def _refuse_unit(self, unit: str | None) -> None:
        if unit == "degF":
            raise WrongDevice(f"{self._device} is set to °F; set it to °C at its panel, then check its setpoint")

    def _latch(self, alarms: tuple[str, ...]) -> None:
        self._latched += tuple(alarm for alarm in alarms if alarm not in self._latched)

    def _is_expected(self, model: str) -> bool:
        return model.upper().startswith((self._asks.expected_model or "").upper())

    def _require_identity(self) -> None:
        if self._identity is None:
            self.identify()

    def _settle_on(self, setpoint_degC: float, *, looks: int = ATTEMPTS) -> ControllerState:
        """Write setpoint and native limits in the order that the controller accepts, read back, return the state."""
        present = self._state()
        wanted = self._native.around(setpoint_degC, present.temperature)
        for write in writes_in_order(self._native.held(present), wanted, self._controller.resolution_degC):
            self._write(*write)
        while True:
            looks, state = looks - 1, self._state()
            try:
                confirm_settings(self._native.held(state), wanted, self._controller.resolution_degC, self._device)
                self._confirmed = setpoint_degC
                return state
            except ProtocolError:
                # A late reply to the question before the writes still shows the old values: ask once more.
                if not looks:
                    raise

    def _write(self, which: Which, value_degC: float) -> None:
        if which == "setpoint":
            self._confirmed = None
        self.wear.writes[which if which == "setpoint" else f"{which} limit"] += 1
        self._controller.write(which, value_degC)

    def _confirm_mode(self, *modes: str, looks: int) -> None:
        while (mode := self._look().mode) not in modes:
            looks -= 1
            if not looks:
                raise ProtocolError(f"{self._device} is in mode {mode} and not in {' or '.join(modes)}")
            self._clock.sleep(_MODE_CHANGE_S)

    def _reach_safe_state(self) -> None:
        """Write whatever is missing to the safe state, then insist on reading it."""
        problem = _tried(lambda: self._insist_on_safe(looks=1))
        if problem is None:
            return
        # A chamber that does not answer may still hear: everything is sent, and nothing more asked until the end.
        silent = isinstance(problem, DeviceTimeout)
        seen = None if silent else _tried(self._look)
        actions = self._safe_actions(seen if isinstance(seen, ControllerState) else None, silent=silent)
        refused = [error for action in actions if (error := _tried(action))]
        problem = _tried(lambda: self._insist_on_safe(looks=ATTEMPTS))
        if problem is not None:
            raise (refused or [problem])[0]

    def _safe_actions(self, state: ControllerState | None, *, silent: bool) -> list[Callable[[], None]]:
        """Return what leads from `state` (None: it could not be read) to the safe state."""
        controller = self._controller
        if state is not None and self._unit_of(state) == "degF" and self._asks.safe.action == "hold":
            # A number means something else now. Nothing is held: what can be stopped is stopped, and somebody told.
            return [lambda: controller.stop(off=False)] if controller.can_stop else []
        actions: list[Callable[[], None]] = []
        mode = None if state is None else state.mode
        if mode is None or mode == "RUN" or not controller.sees_programs:
            actions.append(controller.end_program)
        if self._asks.safe.action != "hold":
            return [*actions, lambda: controller.stop(off=self._asks.safe.action == "off")]
        actions.append(lambda: self._set_safe_temperature(silent=silent))
        if mode != "CONSTANT":
            actions.append(controller.start)
        return actions

    def _set_safe_temperature(self, *, silent: bool) -> None:
        setpoint = self._representable(self._asks.safe.temperature_degC or 0.0)  # what is held has one
        # On a line where every look is slow, what counts is the last; where native limits cannot be had, the setpoint.
        if silent or isinstance(_tried(lambda: self._settle_on(setpoint, looks=1)), DeviceError):
            self._write("setpoint", setpoint)

    def _representable(self, setpoint_degC: float) -> float:
        return representable_setpoint(setpoint_degC, self.limits, self._controller.resolution_degC)

    def _insist_on_safe(self, *, looks: int) -> None:
        if self._asks.safe.action == "hold":
            setpoint, wanted = self._state().setpoint, self._representable(self._asks.safe.temperature_degC or 0.0)
            if not agrees(setpoint, wanted, self._controller.resolution_degC):
                raise ProtocolError(f"{self._device} has setpoint {setpoint:g} °C")
        modes = {"hold": ["CONSTANT"], "standby": ["STANDBY", "OFF"], "off": ["OFF"]}[self._asks.safe.action]
        self._confirm_mode(*modes, looks=looks)


def _tried(action: Callable[[], Result]) -> Result | DeviceError:
    """Return what an action does, or the error that it ends with; a line that is gone is for whoever asked."""
    try:
        return action()
    except TransportError:
        raise
    except DeviceError as error:
        return error
