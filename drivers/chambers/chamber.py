"""The chamber as procedures see it: read it, give it a setpoint, bring it to its safe state."""

from dataclasses import dataclass
from typing import Annotated, Literal, Protocol

from pydantic import BeforeValidator


@dataclass(frozen=True)
class ChamberIdentity:
    """Who answered: model and firmware as the controller gives them, and the unit in which it speaks."""

    model: str
    unit: str  # "degC"; a driver refuses a controller whose unit it cannot confirm


@dataclass(frozen=True)
class ChamberReading:
    """One look at the chamber, all temperatures in °C."""

    temperature_degC: float
    setpoint_degC: float
    high_limit_degC: float
    low_limit_degC: float
    mode: str  # the controller's own word: OFF, STANDBY, CONSTANT, RUN
    alarms: tuple[str, ...] = ()


@dataclass(frozen=True)
class ChamberLimits:
    """The range in which the bench may set the chamber, °C. The second layer after the chamber's own cut-out."""

    low_degC: float
    high_degC: float


@dataclass(frozen=True)
class SafeState:
    """How the chamber may be left alone, as the bench file defines it.

    `hold` keeps it at `temperature_degC` under its own controller (where the unit gives off heat, or condensation must
    be avoided); `standby` stops heating and cooling; `off` switches the conditioning off. Raises `ValueError` where
    a held temperature is missing, or given for a state that has none.
    """

    # YAML 1.1 reads an unquoted off as false.
    action: Annotated[Literal["hold", "standby", "off"], BeforeValidator(lambda it: "off" if it is False else it)]
    temperature_degC: float | None = None

    def __post_init__(self) -> None:
        if self.action not in ("hold", "standby", "off"):
            raise ValueError(f"safe state {self.action!r} is none of hold, standby, off")
        if (self.action == "hold") != (self.temperature_degC is not None):
            raise ValueError("a safe state has a temperature when, and only when, its action is hold")

    @property
    def words(self) -> str:
        """What it is, as messages say it."""
        return self.action if self.temperature_degC is None else f"{self.action} at {self.temperature_degC:g} °C"


class Chamber(Protocol):
    """An environmental chamber. Every method either does what it says or raises a `DeviceError`."""

    @property
    def limits(self) -> ChamberLimits:
        """The limits given by the bench file."""

    @property
    def wear_warning(self) -> str | None:
        """What is to be said about the wear of the memory that its setpoints are kept in, None for nothing."""

    def identify(self) -> ChamberIdentity:
        """Ask who is there and in which unit it speaks; raise `WrongDevice` where the bench file says otherwise."""

    def prepare(self) -> None:
        """Set the native limits (second safety layer) and start constant-temperature operation."""

    def read(self) -> ChamberReading:
        """Read temperature, setpoint, limits, mode and alarms."""

    def set_temperature(self, setpoint_degC: float) -> None:
        """Set, read back and compare the setpoint; raise `SetpointOutOfLimits` before anything is sent."""

    def safe_state(self) -> SafeState:
        """Bring the chamber to the state in which it may be left alone (as the bench file defines it); return that."""

    def close(self) -> None:
        """Release the port without changing the chamber's state."""
