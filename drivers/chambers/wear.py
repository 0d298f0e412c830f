"""How often a controller's memory was written, and what that means: many keep setpoints in memory that wears out.

Watlow gives about a million writes, older parts a hundred thousand. A setpoint stepped by the host every 10 s through a
night is 3600 writes; a plain sweep is a few dozen.
"""

from collections import Counter

from drivers.clock import Clock

ENDURANCE_WRITES = 100_000  # the weaker class of part
_NIGHT_S = 10 * 3600.0
_WORTH_SAYING_NIGHTS = 365.0


class WriteWear:
    """Counts what is written, by name, from the moment it is made."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._began_s = clock.now()
        self._writes: Counter[str] = Counter()

    def note(self, what: str) -> None:
        """Count one write of `what`."""
        self._writes[what] += 1

    @property
    def writes(self) -> dict[str, int]:
        """How often each was written."""
        return dict(self._writes)

    def warning(self) -> str | None:
        """Say in how many nights the most written memory is worn out, None where that is further off than a year."""
        if not self._writes:
            return None
        what, count = self._writes.most_common(1)[0]
        nights_so_far = max((self._clock.now() - self._began_s) / _NIGHT_S, 1.0)
        nights = ENDURANCE_WRITES / (count / nights_so_far)
        if nights >= _WORTH_SAYING_NIGHTS:
            return None
        return (
            f"{what} was written {count} times; at this rate a memory of {ENDURANCE_WRITES} writes is worn out in "
            f"{nights:.0f} nights: use the controller's own ramp, or larger steps"
        )
