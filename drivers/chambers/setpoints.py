"""What every chamber driver does once with a setpoint and with a reading, whatever its protocol.

A setpoint is checked against the bench's limits, then rounded to what the controller can hold, then checked again,
and only then sent; what the controller says afterwards must agree within half of its resolution. The chamber's own
limits are the second safety layer, written in an order that fits: it refuses a setpoint beyond its present limits.

    >>> target = representable_setpoint(-29.72, ChamberLimits(-35.0, 65.0), resolution_degC=0.1)
    >>> target
    -29.7
    >>> [which for which, _ in writes_in_order(Settings(-75, 85, 105), Settings(-45, target, 80), 0.1)]
    ['setpoint', 'high', 'low']
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from drivers.chambers.chamber import ChamberLimits
from drivers.chambers.controller import Controller, ControllerState, Which
from drivers.errors import ProtocolError, SensorFault, SetpointOutOfLimits, WrongDevice

# Nothing that a test chamber can reach lies outside; broken sensors read -3276.8, 850, 999.9 or 9999.
COLDEST_POSSIBLE_DEGC = -110.0
HOTTEST_POSSIBLE_DEGC = 350.0
# A laboratory at 10 to 35 °C, read by a controller that speaks °F.
_ROOM_IN_DEGF = (50.0, 95.0)
# Climatic chambers end at 150 to 200 °C, which is 302 to 392 °F.
_HIGHEST_CHAMBER_MAXIMUM_DEGC = 250.0


class Settings(NamedTuple):
    """The three temperatures a controller holds, °C: native low limit, setpoint, native high limit."""

    low: float
    setpoint: float
    high: float


def representable_setpoint(wanted_degC: float, limits: ChamberLimits, resolution_degC: float) -> float:
    """Return the value nearest to `wanted_degC` that the controller can hold and that lies within `limits`.

    The wanted value itself must lie within the limits. Where rounding would step over one of them, the last
    representable value inside is returned. Raises `SetpointOutOfLimits`; nothing has been sent then.
    """
    if not math.isfinite(wanted_degC):
        raise SetpointOutOfLimits(f"setpoint {wanted_degC} is not a temperature; nothing was sent")
    if not limits.low_degC <= wanted_degC <= limits.high_degC:
        raise SetpointOutOfLimits(
            f"setpoint {wanted_degC:g} °C lies outside the bench's limits of {limits.low_degC:g} to "
            f"{limits.high_degC:g} °C; nothing was sent"
        )
    tolerance = 1e-9  # 600 * 0.1 is not exactly 60.0
    least = math.ceil((limits.low_degC - tolerance) / resolution_degC)
    most = math.floor((limits.high_degC + tolerance) / resolution_degC)
    if least > most:
        raise SetpointOutOfLimits(
            f"no setpoint in steps of {resolution_degC:g} °C lies within {limits.low_degC:g} to "
            f"{limits.high_degC:g} °C; nothing was sent"
        )
    return round(min(max(round(wanted_degC / resolution_degC), least), most) * resolution_degC, 6)


def clamped(temperature_degC: float, limits: ChamberLimits) -> float:
    """Return the temperature within `limits` that is nearest to `temperature_degC`."""
    return min(max(temperature_degC, limits.low_degC), limits.high_degC)


@dataclass(frozen=True)
class NativeLimits:
    """A controller's own limits, the second safety layer: `margin_degC` beyond the bench's `limits`, in tenths."""

    controller: Controller
    limits: ChamberLimits
    margin_degC: float

    @property
    def _usual(self) -> tuple[float, float]:
        limits, margin_degC = self.limits, self.margin_degC
        return round(limits.low_degC - margin_degC, 1), round(limits.high_degC + margin_degC, 1)

    def around(self, setpoint_degC: float, air_degC: float) -> Settings:
        """Return what to write with a setpoint while the air is at `air_degC`.

        A limit that alarms, and that the air is still beyond (a chamber found hot, a bench warmer than the room), would
        do so at once: it is kept `margin_degC` beyond the air till a later setpoint; not for a broken sensor.
        """
        low, high = self._usual
        if self.controller.limits_alarm and _is_possible(air_degC):
            low = low if air_degC >= low else round(air_degC - self.margin_degC, 1)
            high = high if air_degC <= high else round(air_degC + self.margin_degC, 1)
        return Settings(low, setpoint_degC, high)

    def held(self, state: ControllerState) -> Settings:
        """Return what the controller holds; a limit that it does not have is as it should be."""
        low, high = self._usual
        low, high = low if state.low is None else state.low, high if state.high is None else state.high
        return Settings(low, state.setpoint, high)


def agrees(read_degC: float, wanted_degC: float, resolution_degC: float) -> bool:
    """Say whether a value read back is the one that was set: within half of the controller's resolution."""
    return abs(read_degC - wanted_degC) <= resolution_degC / 2 + 1e-9


def confirm_settings(read: Settings, wanted: Settings, resolution_degC: float, device: str) -> None:
    """Raise `ProtocolError` naming each of the three that did not come back as it was set."""
    names: dict[Which, str] = {"setpoint": "setpoint", "low": "low limit", "high": "high limit"}
    wrong = [
        f"{name} {was:g} °C instead of {should:g} °C"
        for which, name in names.items()
        if not agrees(was := getattr(read, which), should := getattr(wanted, which), resolution_degC)
    ]
    if wrong:
        raise ProtocolError(f"{device} reads back {', '.join(wrong)}; check that nobody sets it at its panel")


def writes_in_order(present: Settings, wanted: Settings, resolution_degC: float) -> list[tuple[Which, float]]:
    """Return the writes that lead from `present` to `wanted`: widen the limits, set the setpoint, tighten the limits.

    Between any two of them the setpoint lies within the limits, if it does at both ends. What already agrees is not
    written: memory in controllers wears. Raises `SetpointOutOfLimits` where `wanted` contradicts itself.
    """
    if not wanted.low <= wanted.setpoint <= wanted.high:
        raise SetpointOutOfLimits(
            f"setpoint {wanted.setpoint:g} °C lies outside the chamber's own limits of {wanted.low:g} to "
            f"{wanted.high:g} °C; nothing was sent"
        )
    turn: dict[Which, int] = {
        "high": 1 if wanted.high <= present.high else -1,
        "low": 1 if wanted.low >= present.low else -1,
        "setpoint": 0,
    }
    return [
        (which, getattr(wanted, which))
        for which in sorted(turn, key=turn.__getitem__)
        if not agrees(getattr(present, which), getattr(wanted, which), resolution_degC)
    ]


def _is_possible(degC: float) -> bool:
    return COLDEST_POSSIBLE_DEGC <= degC <= HOTTEST_POSSIBLE_DEGC


def check_plausible(reading_degC: float, device: str) -> None:
    """Raise `SensorFault` for a reading that no working sensor can give (a broken one often can)."""
    if not _is_possible(reading_degC):
        raise SensorFault(f"{device} reads {reading_degC:g} °C, as a broken sensor does; check its temperature sensor")


def reads_as_fahrenheit(read: float, confirmed_degC: float, resolution_degC: float) -> bool:
    """Say whether a setpoint confirmed in °C now reads as its own value in °F; near -40 that cannot be told."""
    as_degF = confirmed_degC * 1.8 + 32.0
    return agrees(read, as_degF, resolution_degC) and not agrees(read, confirmed_degC, resolution_degC)


def refuse_fahrenheit(reading: float, *, idle: bool, chamber_maximum: float | None, device: str) -> None:
    """Raise `WrongDevice` where a controller that cannot tell its unit seems to speak °F.

    An `idle` chamber is near room temperature: a reading that is a room in °F and no room in °C is suspicious, and
    so is a chamber that says it reaches more than 250 (`chamber_maximum`, None where unknown).
    """
    if chamber_maximum is not None and chamber_maximum > _HIGHEST_CHAMBER_MAXIMUM_DEGC:
        evidence = f"says that it reaches {chamber_maximum:g}"
    elif idle and _ROOM_IN_DEGF[0] <= reading <= _ROOM_IN_DEGF[1]:
        evidence = f"is idle and reads {reading:g}, which as °F is a room at {(reading - 32) / 1.8:.0f} °C"
    else:
        return
    raise WrongDevice(
        f"{device} {evidence}, and it has no command that tells its unit; look at its panel, and if it shows °C say "
        "so in the bench file (or wait until the chamber has come to room temperature)"
    )
