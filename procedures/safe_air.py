"""Whether a chamber is safe: its air says so, not its acknowledgement.

A chamber can take STANDBY, show STANDBY and go on heating. So after the command its air is looked at until it is where
it harms nobody and would stay there, or goes where nothing but the safe state sends it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from drivers.chambers import Chamber, SafeState
from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceError, ProtocolError
from procedures.settings import Polling

ROOM_DEGC = (10.0, 35.0)  # air into which anybody may open the door
_HELD_WITHIN_DEGC = 3.0  # of the temperature that a safe state holds
_LEAST_MOVE_DEGC = 1.0  # more than a control loop's ripple and a thermometer's resolution
_LEAST_MOVE = 0.05  # of the way to go: what a chamber that cools in 3 h by a factor e makes in 9 min
_AT_REST_S = 60.0
_AT_REST_DEGC = 0.3
_SLOW_S = 120.0
_SLOW = 1.0 / 3.0  # of the chamber's ramp: no chamber conditions at that pace when it has far to go


class Word(StrEnum):
    """How a chamber was left."""

    SAFE = "SAFE"
    NOT_SAFE = "NOT SAFE"
    NOT_KNOWN = "NOT KNOWN"


@dataclass(frozen=True)
class Left:
    """How a chamber was left, and what shows it."""

    word: Word = Word.SAFE
    reason: str = ""

    @property
    def safe(self) -> bool:
        """True where the air has shown it."""
        return self.word is Word.SAFE

    def exit_status(self, well: int) -> int:
        """Return `well`, or what a command ends with that leaves the chamber so: 5 NOT SAFE, 6 NOT KNOWN."""
        return {Word.SAFE: well, Word.NOT_SAFE: 5, Word.NOT_KNOWN: 6}[self.word]

    def __str__(self) -> str:
        word = "WHETHER THE CHAMBER IS SAFE IS" if self.word is Word.NOT_KNOWN else "THE CHAMBER IS"
        return f"{word} {self.word}: {self.reason}"


def not_commanded(failure: Exception, reason: str) -> Left:
    """Return how a chamber is left whose safe state failed: one that says no is not safe, a silent one nobody knows."""
    answered = isinstance(failure, CommandRefused | ProtocolError)
    return Left(Word.NOT_SAFE if answered else Word.NOT_KNOWN, reason)


def watch_air(
    chamber: Chamber,
    clock: Clock,
    safe: SafeState,
    polling: Polling,
    waiting: Callable[[str], None],
    ramp_degC_per_min: float = 3.0,
) -> Left:
    """Look at the air until it shows that the safe state acts, or `polling.safe_air_s` have passed.

    `waiting` hears before each wait what is seen; `ramp_degC_per_min` is what the chamber makes when it conditions.
    """
    ends_s, seen = clock.now() + polling.safe_air_s, _Seen(safe, ramp_degC_per_min)
    while True:
        try:
            reading = chamber.read()
        except DeviceError as failure:
            silence = str(failure)
        else:
            silence, proof = "", seen.proof(clock.now(), reading.temperature_degC, reading.setpoint_degC)
            if proof:
                return Left(Word.SAFE, proof)
        if clock.now() >= ends_s:
            break
        waiting(f"{safe.words} is acknowledged; {silence or seen.words}; {ends_s - clock.now():.0f} s left to show it")
        clock.sleep(min(polling.interval_s, max(ends_s - clock.now(), 0.01)))
    if silence:
        return Left(Word.NOT_KNOWN, f"{safe.words} was acknowledged, and the air cannot be read: {silence}")
    in_words = f"in {polling.safe_air_s / 60.0:.0f} min {seen.words}"
    return Left(Word.NOT_SAFE, f"{safe.words} was acknowledged and is not carried out: {in_words}")


class _Seen:
    """What was seen of the air since the command."""

    def __init__(self, safe: SafeState, ramp_degC_per_min: float) -> None:
        held = safe.temperature_degC
        self._low, self._high = ROOM_DEGC if held is None else (held - _HELD_WITHIN_DEGC, held + _HELD_WITHIN_DEGC)
        self._goal = 0.5 * (self._low + self._high)
        where = "the room's" if held is None else f"{held:g} °C"
        self._towards = f"towards {where}; before a door is opened, see that it is there"
        self._slow_per_s = _SLOW * ramp_degC_per_min / 60.0
        self._air: list[tuple[float, float]] = []
        self.words = ""

    def proof(self, now_s: float, air: float, setpoint: float) -> str:
        """Take a reading in and return what proves by now that the safe state acts; nothing where nothing does."""
        self._air.append((now_s, air))
        began_s, first = self._air[0]
        self.words = f"the air went from {first:.1f} to {air:.1f} °C, the setpoint is {setpoint:.1f} °C"
        harmless = self._low <= setpoint <= self._high  # it may condition or not
        if self._low <= air <= self._high:
            before = [each for at_s, each in self._air if at_s <= now_s - _AT_REST_S]
            at_rest = bool(before) and abs(before[-1] - setpoint) - abs(air - setpoint) < _AT_REST_DEGC
            return f"the air is at {air:.1f} °C" if harmless or at_rest else ""
        farthest = max((each for _, each in self._air), key=lambda each: abs(each - self._goal))
        way = abs(farthest - self._goal)
        if not way - abs(air - self._goal) >= max(_LEAST_MOVE_DEGC, _LEAST_MOVE * way):  # so that NaN proves nothing
            return ""
        # It moves home. Would it, if it still drove to its setpoint?
        leaves = (setpoint - air) * (self._goal - air) < 0.0
        passed_s = now_s - began_s
        slow = passed_s >= _SLOW_S and abs(air - first) < self._slow_per_s * passed_s
        moved = f"the air has moved from {farthest:.1f} to {air:.1f} °C in {passed_s / 60.0:.0f} min, {self._towards}"
        return moved if harmless or leaves or slow else ""
