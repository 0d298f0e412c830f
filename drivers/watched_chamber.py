"""Alarms latched and readings judged over time, for a chamber driver that does not do so itself.

    chamber = WatchedChamber(EspecChamber(transport, clock, limits=limits, safe=safe), clock, device="chamber on COM3")

`SupervisedChamber` does the same for every controller that it supervises; this is for drivers that are whole chambers.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.chamber import Chamber, ChamberIdentity, ChamberLimits, ChamberReading
from drivers.clock import Clock
from drivers.errors import SensorFault
from drivers.reading_watch import ReadingWatch, WatchSettings
from drivers.write_wear import wear_of

_ATTEMPTS = 3


class WatchedChamber:
    """A `Chamber` over another. `device` begins the messages of its watch."""

    def __init__(self, chamber: Chamber, clock: Clock, *, device: str, watch: WatchSettings | None = None) -> None:
        self._chamber = chamber
        self._clock = clock
        self._watch = ReadingWatch(device, watch)
        self._latched: tuple[str, ...] = ()

    @property
    def limits(self) -> ChamberLimits:
        """The limits given by the bench file."""
        return self._chamber.limits

    @property
    def wear_warning(self) -> str | None:
        """What the chamber itself says about the wear of its memory."""
        return wear_of(self._chamber)

    def identify(self) -> ChamberIdentity:
        """Ask who is there and in which unit it speaks."""
        return self._chamber.identify()

    def prepare(self) -> None:
        """Prepare the chamber; alarms that were seen are forgotten once that has succeeded."""
        self._watch.forget()
        self._chamber.prepare()
        self._latched = ()

    def read(self) -> ChamberReading:
        """Read; alarms are those that stand or were seen since the chamber was prepared.

        Raises `SensorFault` where the temperature still cannot be true after three looks.
        """
        for attempt in range(1, _ATTEMPTS + 1):
            reading = self._chamber.read()
            driven_to = reading.setpoint_degC if reading.mode == "CONSTANT" else None
            try:
                self._watch.accept(self._clock.now(), reading.temperature_degC, driven_to_degC=driven_to)
                break
            except SensorFault:
                if attempt == _ATTEMPTS:
                    raise
        self._latched += tuple(alarm for alarm in reading.alarms if alarm not in self._latched)
        return replace(reading, alarms=self._latched)

    def set_temperature(self, setpoint_degC: float) -> None:
        """Set, read back and compare the setpoint."""
        self._chamber.set_temperature(setpoint_degC)

    def safe_state(self) -> None:
        """Bring the chamber to its safe state."""
        self._chamber.safe_state()

    def close(self) -> None:
        """Release the port; the chamber goes on as it is."""
        self._chamber.close()
