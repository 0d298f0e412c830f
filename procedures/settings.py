"""What a sweep asks for, as plain numbers: temperatures, soaks, collects, limits and poll intervals.

The configuration files convert to these; units have been checked by then. Values that contradict each other raise
`ValueError` with one sentence that names the setting.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Self

_LARGEST = {
    "_deg_per_hr_per_min": (1e6, "a million deg/hr/min"),
    "_degC_per_min": (100.0, "100 °C/min"),
    "_degC": (350.0, "350 °C"),
    "_s": (7 * 86400.0, "7 days"),
    "_mb": (1e9, "10⁹ MB"),
    "_g": (100.0, "100 g"),
    "": (1000.0, "1000"),
}
"""The largest that any setting can sensibly be, by the unit in its name: beyond it stands a slip of the pen."""


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise ValueError(sentence)


def _require_possible(settings: Any, section: str, positive: str = "", not_negative: str = "") -> None:
    """Raise `ValueError` for a setting that is no finite number, larger than any can be, or not `positive` (names)."""
    for item in fields(settings):
        value = getattr(settings, item.name)
        largest, words = next(limit for suffix, limit in _LARGEST.items() if item.name.endswith(suffix))
        finite = math.isfinite(value) and abs(value) <= largest
        _require(finite, f"{section}: {item.name} must be a finite number of at most {words}, not {value:g}")
    for name in positive.split():
        value = getattr(settings, name)
        _require(value > 0.0, f"{section}: {name} must be positive, not {value}")
    for name in not_negative.split():
        value = getattr(settings, name)
        _require(value >= 0.0, f"{section}: {name} must not be negative, not {value}")


class _Parameters:
    """Settings that travel inside a step as named numbers, so that a plan is complete by itself."""

    def as_parameters(self) -> dict[str, float]:
        """Return the settings as numbers by name; those that are not set are absent."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}  # type: ignore[arg-type]
        return {name: float(value) for name, value in values.items() if value is not None}

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, float]) -> Self:
        """Return the settings that `as_parameters` wrote; other numbers in `parameters` are left alone."""
        kinds: dict[str, Any] = {item.name: type(item.default) for item in fields(cls)}  # type: ignore[arg-type]
        return cls(**{name: kinds[name](value) for name, value in parameters.items() if name in kinds})


@dataclass(frozen=True)
class Restabilisation(_Parameters):
    """When the unit counts as being in thermal equilibrium.

    All of these at once: `at_least_s` of soak in the band; over the last `window_s` the chamber within `band_degC` of
    the setpoint and sloping less than `slope_degC_per_min`; over the same window the unit's own sensor within a span
    of `unit_band_degC` and sloping less than `unit_slope_degC_per_min`. The unit's own heat keeps it above the
    chamber's air, so its level is not compared with the setpoint; only that it stands still. Raises `ValueError` where
    a number is impossible, or the ceiling would always come first.
    """

    at_least_s: float = 45 * 60.0
    band_degC: float = 0.5
    slope_degC_per_min: float = 0.05
    window_s: float = 600.0
    unit_band_degC: float = 0.5
    unit_slope_degC_per_min: float = 0.05
    ceiling_s: float = 4 * 3600.0  # never wait longer than this, whatever the evidence
    excursion_s: float = 120.0  # leaving the band for longer restarts the soak; for less, only the window
    collect_at_ceiling: bool = True  # collect all the same (INCONCLUSIVE, never PASS), or skip the self-calibration

    def __post_init__(self) -> None:
        positive = "band_degC slope_degC_per_min window_s unit_band_degC unit_slope_degC_per_min"
        _require_possible(self, "restabilisation", positive, "at_least_s excursion_s")
        shortest = max(self.at_least_s, self.window_s)
        _require(
            self.ceiling_s >= shortest,
            f"restabilisation: ceiling_s ({self.ceiling_s:g}) is shorter than the scheduled soak or its evidence "
            f"window ({shortest:g}), so it would always end there",
        )


@dataclass(frozen=True)
class CollectSettings(_Parameters):
    """How a collect is taken and when it is believed. Raises `ValueError` where a number is impossible."""

    settle_s: float = 20.0  # after the index, thrown away
    duration_s: float = 60.0
    index_timeout_s: float = 60.0
    index_s: float = 20.0  # expected, for the plan's times
    minimum_fraction: float = 0.95  # of the expected samples; fewer is INCONCLUSIVE
    drift_limit_deg_per_hr_per_min: float = 10.0
    drift_sigmas: float = 4.0  # a slope counts only where it is this many standard errors from zero
    motion_limit_g: float = 0.005  # largest departure of a one-second mean of an accelerometer from its mean
    frozen_s: float = 5.0  # a rate that does not change for so long is not being measured; 0 never
    attempts: int = 2  # a collect that is not good is taken again, the last one is kept as it is

    def __post_init__(self) -> None:
        positive = "duration_s index_timeout_s drift_limit_deg_per_hr_per_min drift_sigmas motion_limit_g"
        _require_possible(self, "collect", positive, "settle_s index_s frozen_s")
        _require(0.0 < self.minimum_fraction <= 1.0, "collect: minimum_fraction must lie above 0 and not above 1")
        _require(self.attempts >= 1, "collect: attempts must be at least 1")


@dataclass(frozen=True)
class SweepProcedure:
    """A temperature sweep: at each temperature, so many self-calibrations, each of collects at the positions in order.

    `positions` may repeat and come in any order (1-3-2 keeps a linear drift out of the bias and MU). There is at least
    one of each, as the sweep file's own keys say.
    """

    title: str
    temperatures_degC: tuple[float, ...]
    self_calibrations: int = 3
    positions: tuple[str, ...] = ("1", "2", "3")
    restabilisation: Restabilisation = field(default_factory=Restabilisation)
    collect: CollectSettings = field(default_factory=CollectSettings)
    ramp_degC_per_min: float = 3.0  # expected of the chamber
    start_degC: float = 23.0  # expected of the chamber at the beginning
    final_degC: float | None = None  # brought here before the safe state, so that nobody opens a cold chamber


@dataclass(frozen=True)
class Polling:
    """How often the bench is looked at.

    `interval_s` is the chamber's; `read_interval_s` drains the stream so often that no live serial buffer (4 kB)
    overflows. Under the virtual clock both may be tens of seconds. Raises `ValueError` for the impossible.
    """

    interval_s: float = 5.0
    read_interval_s: float = 0.5
    heartbeat_s: float = 60.0
    progress_s: float = 1.0
    device_attempts: int = 3  # tries of a step that a device refuses, before the night ends safely
    retry_wait_s: float = 5.0
    safe_state_s: float = 300.0  # how long the safe state is tried for, where the chamber does not answer
    safe_air_s: float = 900.0  # how long the air is then looked at, until it shows that the chamber does as it was told

    def __post_init__(self) -> None:
        _require_possible(self, "polling", "interval_s read_interval_s heartbeat_s")
        _require(self.device_attempts >= 1, "polling: device_attempts must be at least 1")
        _require(self.retry_wait_s >= 0.0, "polling: retry_wait_s must not be negative")


@dataclass(frozen=True)
class InterlockSettings:
    """What ends a night in the safe state, and how long each may last before it does.

    The grace is the retry: a condition that clears within it is recorded and the night goes on, but no step begins
    while one is suspected. Raises `ValueError` where a number is impossible.
    """

    chamber_margin_degC: float = 3.0  # beyond the bench's limits: the chamber overshoots, a runaway does not stop
    chamber_limit_grace_s: float = 60.0
    unit_low_degC: float = -60.0
    unit_high_degC: float = 90.0
    unit_limit_grace_s: float = 30.0
    alarm_grace_s: float = 15.0
    chamber_loss_s: float = 120.0
    stream_loss_s: float = 60.0
    setpoint_tolerance_degC: float = 0.3  # between what was commanded and what the chamber says it holds
    setpoint_grace_s: float = 60.0
    follow_tolerance_degC: float = 3.0  # between air and setpoint, once the setpoint was reached
    follow_grace_s: float = 15 * 60.0
    unsettled_soaks: int = 3  # in a row, where self-calibrations are skipped at the ceiling: then the night is over
    ramp_factor: float = 3.0  # a ramp may take so many times the expected duration …
    ramp_extra_s: float = 20 * 60.0  # … and this on top
    chamber_rate_degC_per_min: float = 25.0  # the fastest test chambers make 15
    unit_rate_degC_per_min: float = 12.0
    rate_grace_s: float = 60.0
    frozen_s: float = 60.0  # a unit whose rates all stand still for so long sends, but does not measure
    disk_low_mb: float = 20.0  # free where the records go; below it the night ends before a write fails
    disk_grace_s: float = 60.0
    pause_s: float = 12 * 3600.0  # the longest pause; then nobody comes back

    def __post_init__(self) -> None:
        own = [item.name for item in fields(self) if not item.name.startswith("unit_") or item.name.endswith("_s")]
        _require_possible(self, "interlocks", not_negative=" ".join(own))
        _require(self.unit_low_degC < self.unit_high_degC, "interlocks: unit_low_degC must be below unit_high_degC")
