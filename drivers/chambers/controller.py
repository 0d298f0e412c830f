"""What differs between chamber controllers, as `SupervisedChamber` needs it: one small class per protocol on a wire.

A controller says what is and does what it is told, once. It judges nothing: limits, order, read-back, unit, alarms,
plausibility and the safe state are the same for all of them and live in `drivers.chambers.supervised`.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

from drivers.transports import Transport

Mode = Literal["OFF", "STANDBY", "CONSTANT", "RUN"]
Unit = Literal["degC", "degF"]
Which = Literal["low", "setpoint", "high"]


@dataclass(frozen=True)
class ControllerIdentity:
    """Who answered. `unit` is None where the protocol cannot tell it; `maximum` is the hottest it says it can be."""

    model: str
    unit: Unit | None = None
    maximum: float | None = None


@dataclass(frozen=True)
class ControllerState:
    """One look at a controller, in the unit it speaks.

    `mode` is CONSTANT where it conditions to its setpoint, RUN where a program does, STANDBY or OFF where nothing does
    (OFF for a controller that knows one kind of stop). A native limit that it does not have is None; so is a unit.
    """

    temperature: float
    setpoint: float
    mode: Mode
    alarms: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    unit: Unit | None = None


class Controller(ABC):
    """One kind of controller on one port. Reads are retried inside; what is written is written once.

    `device` is how messages begin: `chamber on /dev/ttyUSB0`. `resolution_degC` is the step in which it holds a
    setpoint; `limits_alarm` says whether its own limits alarm at the air and do not only bound setpoints; `can_stop`,
    whether conditioning can be stopped over the line; `sees_programs`, whether a program that runs shows as mode RUN:
    where not, the safe state ends one in any case. What is not so of one, its class says.
    """

    limits_alarm = False
    sees_programs = True
    resolution_degC = 0.1
    can_stop = True

    def __init__(self, transport: Transport, kind: str = "chamber") -> None:
        self.device = f"{kind} on {transport.name}"
        self._transport = transport

    @abstractmethod
    def identify(self) -> ControllerIdentity:
        """Ask who is there; raise `WrongDevice` where it is no such controller."""

    @abstractmethod
    def state(self) -> ControllerState:
        """Look at everything once."""

    @abstractmethod
    def write(self, which: Which, value: float) -> None:
        """Send a setpoint or a native limit once. A lost acknowledgement is no error; a refusal is."""

    @abstractmethod
    def start(self) -> None:
        """Begin conditioning to the setpoint it holds; whether it did is read back."""

    @abstractmethod
    def stop(self, *, off: bool) -> None:
        """Stop conditioning: switched off, or standing by where the controller knows the difference."""

    @abstractmethod
    def end_program(self) -> None:
        """End a program that is running."""

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Bound the ramp from now on, confirm it, or raise a `DeviceError`; False where it is not equipped for it."""
        return False

    def arm_dead_man(self, seconds: float) -> bool:
        """Let it stop by itself when left alone for so long; confirm it, raise, or return False as with a ramp."""
        return False

    def close(self) -> None:
        """Release the port."""
        self._transport.close()
