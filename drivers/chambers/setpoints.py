"""What every chamber driver does once with a setpoint and with a reading, whatever its protocol.

A setpoint is checked against the bench's limits, then rounded to what the controller can hold, then checked again,
and only then sent; what the controller says afterwards must agree within half of its resolution. The chamber's own
limits are the second safety layer, and the order in which they are written matters: a controller refuses a setpoint
beyond its present limits.

    >>> target = representable_setpoint(-29.72, ChamberLimits(-35.0, 65.0), resolution_degC=0.1)
    >>> target
    -29.7
    >>> [write.which for write in writes_in_order(Settings(-75, 85, 105), Settings(-45, target, 80), 0.1)]
    ['setpoint', 'high', 'low']
"""

import math
from dataclasses import dataclass
from typing import Literal

from drivers.chambers.chamber import ChamberLimits
from drivers.errors import ProtocolError, SensorFault, SetpointOutOfLimits, WrongDevice

# Nothing that a test chamber can reach lies outside; broken sensors read -3276.8, 850, 999.9 or 9999.
COLDEST_POSSIBLE_DEGC = -110.0
HOTTEST_POSSIBLE_DEGC = 350.0
# A laboratory at 10 to 35 °C, read by a controller that speaks °F.
_ROOM_IN_DEGF = (50.0, 95.0)
# Climatic chambers end at 150 to 200 °C, which is 302 to 392 °F.
_HIGHEST_CHAMBER_MAXIMUM_DEGC = 250.0


@dataclass(frozen=True)
class Settings:
    """The three temperatures a controller holds, °C: native low limit, setpoint, native high limit."""

    low_degC: float
    setpoint_degC: float
    high_degC: float


@dataclass(frozen=True)
class SettingWrite:
    """One of the three is to be written."""

    which: Literal["low", "setpoint", "high"]
    value_degC: float


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
    steps = round(wanted_degC / resolution_degC)
    tolerance = 1e-9  # 600 * 0.1 is not exactly 60.0
    if steps * resolution_degC > limits.high_degC + tolerance:
        steps -= 1
    if steps * resolution_degC < limits.low_degC - tolerance:
        steps += 1
    value = round(steps * resolution_degC, 6)
    if not limits.low_degC - tolerance <= value <= limits.high_degC + tolerance:
        raise SetpointOutOfLimits(
            f"no setpoint in steps of {resolution_degC:g} °C lies within {limits.low_degC:g} to "
            f"{limits.high_degC:g} °C; nothing was sent"
        )
    return value


def clamped(temperature_degC: float, limits: ChamberLimits) -> float:
    """Return the temperature within `limits` that is nearest to `temperature_degC`."""
    return min(max(temperature_degC, limits.low_degC), limits.high_degC)


def limits_around(native: ChamberLimits, air_degC: float, margin_degC: float) -> ChamberLimits:
    """Return the native limits to write while the air is at `air_degC`, in tenths.

    A limit that the air is still beyond (a chamber found hot, a bench warmer than the room) would raise an alarm at
    once: it is kept `margin_degC` beyond the air, and tightened with a later setpoint. A broken sensor widens nothing.
    """
    if not math.isfinite(air_degC) or not COLDEST_POSSIBLE_DEGC <= air_degC <= HOTTEST_POSSIBLE_DEGC:
        return native
    return ChamberLimits(
        native.low_degC if air_degC >= native.low_degC else round(air_degC - margin_degC, 1),
        native.high_degC if air_degC <= native.high_degC else round(air_degC + margin_degC, 1),
    )


def agrees(read_degC: float, wanted_degC: float, resolution_degC: float) -> bool:
    """Say whether a value read back is the one that was set: within half of the controller's resolution."""
    return abs(read_degC - wanted_degC) <= resolution_degC / 2 + 1e-9


def confirm_settings(read: Settings, wanted: Settings, resolution_degC: float, device: str) -> None:
    """Raise `ProtocolError` naming each of the three that did not come back as it was set."""
    wrong = [
        f"{name} {was:g} °C instead of {should:g} °C"
        for name, was, should in (
            ("setpoint", read.setpoint_degC, wanted.setpoint_degC),
            ("low limit", read.low_degC, wanted.low_degC),
            ("high limit", read.high_degC, wanted.high_degC),
        )
        if not agrees(was, should, resolution_degC)
    ]
    if wrong:
        raise ProtocolError(f"{device} reads back {', '.join(wrong)}; check that nobody sets it at its panel")


def writes_in_order(present: Settings, wanted: Settings, resolution_degC: float) -> list[SettingWrite]:
    """Return the writes that lead from `present` to `wanted`: widen the limits, set the setpoint, tighten the limits.

    Between any two of them the setpoint lies within the limits, if it does at both ends. What already agrees is not
    written: memory in controllers wears. Raises `SetpointOutOfLimits` where `wanted` contradicts itself.
    """
    if not wanted.low_degC <= wanted.setpoint_degC <= wanted.high_degC:
        raise SetpointOutOfLimits(
            f"setpoint {wanted.setpoint_degC:g} °C lies outside the chamber's own limits of {wanted.low_degC:g} to "
            f"{wanted.high_degC:g} °C; nothing was sent"
        )
    high = SettingWrite("high", wanted.high_degC)
    low = SettingWrite("low", wanted.low_degC)
    high_changes = not agrees(present.high_degC, wanted.high_degC, resolution_degC)
    low_changes = not agrees(present.low_degC, wanted.low_degC, resolution_degC)
    high_widens = high_changes and wanted.high_degC > present.high_degC
    low_widens = low_changes and wanted.low_degC < present.low_degC
    writes = [write for write, now in ((high, high_widens), (low, low_widens)) if now]
    if not agrees(present.setpoint_degC, wanted.setpoint_degC, resolution_degC):
        writes.append(SettingWrite("setpoint", wanted.setpoint_degC))
    writes += [
        write for write, now in ((high, high_changes and not high_widens), (low, low_changes and not low_widens)) if now
    ]
    return writes


def plausible_temperature(reading_degC: float, device: str) -> float:
    """Return the reading; raise `SensorFault` where no working sensor can give it (a broken one often can).

    Whether a reading is frozen or jumps shows only over time: that is for the procedure that watches it.
    """
    if not math.isfinite(reading_degC) or not COLDEST_POSSIBLE_DEGC <= reading_degC <= HOTTEST_POSSIBLE_DEGC:
        raise SensorFault(f"{device} reads {reading_degC:g} °C, as a broken sensor does; check its temperature sensor")
    return reading_degC


def reads_as_fahrenheit(read: float, confirmed_degC: float, resolution_degC: float) -> bool:
    """Say whether a setpoint that was confirmed in °C now reads as its own value in °F: the panel was switched.

    Near -40, where the two scales meet, it cannot be told and does not matter yet.
    """
    if agrees(read, confirmed_degC, resolution_degC):
        return False
    return agrees(read, confirmed_degC * 1.8 + 32.0, resolution_degC)


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
