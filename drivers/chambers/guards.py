"""What is remembered of a chamber over time: whether its readings can be true, its memory's wear, its own timer."""

from collections import Counter
from dataclasses import dataclass, field

from drivers.chambers.controller import Controller
from drivers.chambers.setpoints import check_plausible
from drivers.clock import Clock
from drivers.errors import CommandRefused, ProtocolError, SensorFault

# What a chamber's air can do. The fastest test chambers reach 15 °C/min.
_STEP_DEGC = 5.0  # what a reading may change at once
_SLEW_DEGC_PER_MIN = 15.0
_FROZEN_AFTER_S = 900.0  # the very same reading for so long …
_FROZEN_DISTANCE_DEGC = 2.0  # … this far from a setpoint that is being driven to


@dataclass(eq=False)
class ReadingWatch:
    """The readings of one sensor, in the order they were taken: a jump that no air makes, a value that never changes.

    One glitch is asked again by the driver. A jump that stays is a sensor, a changed unit or another channel; the watch
    keeps saying so until the reading is back where it was, or the chamber is prepared anew. `device` begins messages.
    """

    device: str
    _last: tuple[float, float] | None = field(default=None, init=False)  # time, °C
    _jumped_at_s: float | None = field(default=None, init=False)
    _same_since_s = 0.0

    def forget(self) -> None:
        """Begin anew: somebody has looked at the chamber."""
        self._last = self._jumped_at_s = None

    def accept(self, now_s: float, reading_degC: float, *, driven_to_degC: float | None) -> None:
        """Raise `SensorFault` for what cannot be true; `driven_to_degC` is the setpoint, where it is conditioned to."""
        check_plausible(reading_degC, self.device)
        if self._last is not None:
            before_s, before_degC = self._last
            # From the first sight of a jump on, time no longer widens what is allowed: no wrong unit becomes right.
            until_s = now_s if self._jumped_at_s is None else self._jumped_at_s
            allowed_degC = _STEP_DEGC + _SLEW_DEGC_PER_MIN * max(until_s - before_s, 0.0) / 60.0
            self._jumped_at_s = until_s if abs(reading_degC - before_degC) > allowed_degC else None
            if self._jumped_at_s is not None:
                raise SensorFault(
                    f"{self.device} reads {reading_degC:g} °C where it read {before_degC:g} °C "
                    f"{until_s - before_s:.0f} s before, which no chamber's air does; check its sensor, and that its "
                    "panel still shows °C"
                )
        driven = driven_to_degC is not None and abs(reading_degC - driven_to_degC) > _FROZEN_DISTANCE_DEGC
        if not driven or self._last is None or reading_degC != self._last[1]:
            self._same_since_s = now_s
        self._last = (now_s, reading_degC)
        if now_s - self._same_since_s >= _FROZEN_AFTER_S:
            raise SensorFault(
                f"{self.device} has read {reading_degC:g} °C without any change for "
                f"{(now_s - self._same_since_s) / 60.0:.0f} min on its way to {driven_to_degC:g} °C; its sensor is "
                "frozen, or it neither heats nor cools"
            )


ENDURANCE_WRITES = 100_000  # the weaker class of part
_NIGHT_S = 10 * 3600.0
_WORTH_SAYING_NIGHTS = 365.0


class WriteWear:
    """Counts `writes` by the name of what is written: many controllers keep setpoints in memory that wears out.

    Watlow gives about a million writes, older parts a hundred thousand. A setpoint stepped by the host every 10 s
    through a night is 3600 writes; a plain sweep is a few dozen.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock, self._began_s = clock, clock.now()
        self.writes: Counter[str] = Counter()

    def warning(self) -> str | None:
        """Say in how many nights the most written memory is worn out, None where that is further off than a year."""
        if not self.writes:
            return None
        what, count = self.writes.most_common(1)[0]
        nights_so_far = max((self._clock.now() - self._began_s) / _NIGHT_S, 1.0)
        nights = ENDURANCE_WRITES / (count / nights_so_far)
        if nights >= _WORTH_SAYING_NIGHTS:
            return None
        return (
            f"{what} was written {count} times; at this rate a memory of {ENDURANCE_WRITES} writes is worn out in "
            f"{nights:.0f} nights: use the controller's own ramp, or larger steps"
        )


_RENEWED_WITHIN = 0.25  # of its time, so that a renewal which fails can be tried anew


@dataclass(eq=False)
class DeadMan:
    """The timer of one controller; `seconds` None for none at all. What it does raises what the controller raises.

    One that nobody asked for (`asked` False) is armed where the controller has one, and otherwise done without.
    """

    controller: Controller
    clock: Clock
    seconds: float | None
    asked: bool = True
    _armed_at_s: float | None = field(default=None, init=False)

    def arm(self) -> None:
        """Begin its time; raise `CommandRefused` where the controller has no timer."""
        if self.seconds is None:
            return
        device = self.controller.device
        try:
            if not self.controller.arm_dead_man(self.seconds):
                raise CommandRefused(f"{device} has no timer of its own; take dead_man out of the bench file")
        except (CommandRefused, ProtocolError):
            if self.asked:
                raise
            return
        self._armed_at_s = self.clock.now()

    def renew(self) -> None:
        """Begin its time anew, where it was armed and some of it has passed."""
        if self._armed_at_s is None or self.seconds is None:
            return
        if self.clock.now() - self._armed_at_s >= _RENEWED_WITHIN * self.seconds:
            self.arm()

    def rest(self) -> None:
        """Renew it no more; what is left of its time runs out."""
        self._armed_at_s = None
