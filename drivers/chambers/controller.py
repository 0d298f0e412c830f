"""What differs between chamber controllers, as `SupervisedChamber` needs it: one small Protocol per protocol on a wire.

A controller says what is and does what it is told, once. It judges nothing: limits, order, read-back, unit, alarms,
plausibility and the safe state are the same for all of them and live in `drivers.chambers.supervised`.
"""

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from drivers.transports import Transport

Mode = Literal["OFF", "STANDBY", "CONSTANT", "RUN"]
Unit = Literal["degC", "degF"]
Which = Literal["low", "setpoint", "high"]
NativeLimits = Literal["none", "setpoint", "alarm"]


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
    (OFF for a controller that knows one kind of stop). A native limit that it does not have is None; so is a unit
    that it cannot tell.
    """

    temperature: float
    setpoint: float
    mode: Mode
    alarms: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    unit: Unit | None = None


class Controller(Protocol):
    """One kind of controller on one port. Reads are retried inside; what is written is written once."""

    @property
    def device(self) -> str:
        """How messages begin: `chamber on /dev/ttyUSB0`."""

    @property
    def resolution_degC(self) -> float:
        """The step in which it holds a setpoint."""

    @property
    def native_limits(self) -> NativeLimits:
        """Whether it has limits of its own, and whether they bound setpoints or alarm at the air."""

    @property
    def can_stop(self) -> bool:
        """Whether conditioning can be stopped over the line."""

    @property
    def sees_programs(self) -> bool:
        """Whether a program that runs shows as mode RUN; where not, the safe state ends one in any case."""

    def identify(self) -> ControllerIdentity:
        """Ask who is there; raise `WrongDevice` where it is no such controller."""

    def state(self) -> ControllerState:
        """Look at everything once."""

    def write(self, which: Which, value: float) -> None:
        """Send a setpoint or a native limit once. A lost acknowledgement is no error; a refusal is."""

    def start(self) -> None:
        """Begin conditioning to the setpoint it holds; whether it did is read back."""

    def stop(self, *, off: bool) -> None:
        """Stop conditioning: switched off, or standing by where the controller knows the difference."""

    def end_program(self) -> None:
        """End a program that is running."""

    def close(self) -> None:
        """Release the port."""


class OnOnePort:
    """What most controllers have in common. What is not so of one, its class says."""

    native_limits: NativeLimits = "none"
    sees_programs = True
    resolution_degC = 0.1
    can_stop = True

    def __init__(self, transport: Transport, kind: str = "chamber") -> None:
        self.device = f"{kind} on {transport.name}"
        self._transport = transport

    def close(self) -> None:
        """Release the port."""
        self._transport.close()


@runtime_checkable
class RampingController(Protocol):
    """A controller, or a chamber over one, that can bound how fast its setpoint moves."""

    def set_ramp_rate(self, degC_per_min: float) -> bool:
        """Bound the ramp from now on, confirm it, or raise a `DeviceError`; False where it is not equipped for it."""


@runtime_checkable
class DeadManController(Protocol):
    """A controller that stops by itself when it has been left alone for too long."""

    def arm_dead_man(self, seconds: float) -> bool:
        """Set the time and confirm it, or raise a `DeviceError`; False where it is not equipped for it."""
