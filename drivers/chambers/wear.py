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
    """Counts `writes` by the name of what is written, from the moment it is made."""

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
