"""An interlock on how fast a temperature moves: a runaway shows in its rate long before it reaches a limit."""

from collections.abc import Callable, Mapping, Sequence

from procedures.interlocks import Interlock, Look
from procedures.settings import InterlockSettings

_WINDOW_S = 120.0  # over which a rate is judged: long enough for a thermometer's resolution not to matter


class _Rates:
    """Remembers what `values` takes from every look: nothing of it may move faster than the limit."""

    def __init__(self, limit_degC_per_min: float, values: Callable[[Look], Mapping[str, float]]) -> None:
        self._limit = limit_degC_per_min
        self._values = values
        self._seen: dict[tuple[str, str], list[tuple[float, float]]] = {}

    def problem(self, look: Look) -> str | None:
        """Return what moves too fast, "" where nothing does, None where this look has no news."""
        said: list[str] = []
        news = False
        for what, value in self._values(look).items():
            seen = self._seen.setdefault((look.unit, what), [])
            seen.append((look.time_s, value))
            while len(seen) > 2 and look.time_s - seen[0][0] > _WINDOW_S:
                seen.pop(0)
            (begin_s, begin), (end_s, end) = seen[0], seen[-1]
            if end_s - begin_s < _WINDOW_S / 4.0:
                continue
            news = True
            rate = 60.0 * (end - begin) / (end_s - begin_s)
            if abs(rate) > self._limit:
                said.append(f"{what} moves by {rate:+.1f} °C/min, {self._limit:g} are allowed")
        return ", ".join(said) if news else None


def rate_interlocks(settings: InterlockSettings) -> Sequence[Interlock]:
    """Return those of every bench."""
    chamber = _Rates(settings.chamber_rate_degC_per_min, _chamber_air)
    unit = _Rates(settings.unit_rate_degC_per_min, _unit_sensors)
    return (
        Interlock("chamber-rate", settings.rate_grace_s, chamber.problem),
        Interlock("unit-rate", settings.rate_grace_s, unit.problem, of_unit=True),
    )


def _chamber_air(look: Look) -> Mapping[str, float]:
    return {"the chamber": look.chamber.temperature_degC} if look.chamber_fresh and look.chamber is not None else {}


def _unit_sensors(look: Look) -> Mapping[str, float]:
    return {f"sensor {number}": value for number, value in look.unit_degC.items()}
