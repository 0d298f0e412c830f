"""What moves slowly in the simulated unit, on a grid of 5 s: temperatures, coefficients, supply, spin, noise levels."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.frames.roles import Roles
from hil.campaign import FloatArray
from hil.config.simulation import SimulationSection
from hil.errors import InputError
from hil.twin.scatter import SUPPLY, correlated, stream
from hil.twin.sensor import SimulatedSensor
from hil.twin.thermal import GRID_S, ThermalUnit

# Assumed: rotors near 100 Hz, each a per cent off the one before so that they do not beat, slightly slower when cold.
_SPIN_US, _SPIN_STEP_US = 10000.0, -100.0
_SPIN_PER_DEGC = -2e-6
_SPIN_SIGMA_US = 0.02
_REFERENCE_DEGC = 25.0
_SUPPLY_LAG_S = 3600.0
_KEPT = 720  # grid points of what samples are made of

AIR, CASE, ROTOR = 0, 1, 2
_Made = TypeVar("_Made")


class GrowingTable:
    """Rows that are added at the end, in one array. Old ones may be dropped; the others keep their numbers."""

    def __init__(self, columns: int) -> None:
        self._array = np.zeros((256, columns))
        self._count = 0
        self._dropped = 0

    def append(self, rows: FloatArray) -> None:
        """Add rows, shape (m, columns)."""
        needed = self._count + len(rows)
        if needed > len(self._array):
            larger = np.zeros((max(needed, 2 * len(self._array)), self._array.shape[1]))
            larger[: self._count] = self._array[: self._count]
            self._array = larger
        self._array[self._count : needed] = rows
        self._count = needed

    def drop_before(self, row: int) -> None:
        """Let go of the rows before `row`, once that is worth it."""
        old = row - self._dropped
        if old > self._count // 2:
            self._array[: self._count - old] = self._array[old : self._count].copy()
            self._count -= old
            self._dropped += old

    def at(self, rows: NDArray[np.int64]) -> FloatArray:
        """Return the rows of these numbers, shape (n, columns)."""
        return np.asarray(self._array[rows - self._dropped])

    def between(self, first: int, last: int) -> FloatArray:
        """Return the rows from `first` to `last`, both included, a view, shape (m, columns)."""
        return self._array[first - self._dropped : last + 1 - self._dropped]

    @property
    def rows(self) -> FloatArray:
        """All rows, a view, shape (m, columns); for tables of which none is dropped."""
        return self._array[: self._count]


Places = NDArray[np.int64] | slice
"""Columns of readings; a slice where they lie side by side, which is added to in a fraction of the time."""


def _together(places: list[int]) -> Places:
    if places and places == [*range(places[0], places[0] + len(places))]:
        return slice(places[0], places[-1] + 1)
    return np.array(places, dtype=np.int64)


@dataclass(frozen=True)
class FieldColumns:
    """Which column of the readings each field has, by what it is for; rates (c,) and accelerations (k,) by sensor."""

    names: tuple[str, ...]
    rates: Mapping[int, Places]  # by sensor, one per channel
    accelerations: Mapping[int, Places]
    rotors: Mapping[int, int]
    spins: Mapping[int, int]
    case: int | None
    supply: int | None


def field_columns(sensors: Mapping[int, SimulatedSensor], roles: Roles) -> FieldColumns:
    """Lay out the fields that a description's roles ask for; raise `InputError` for one that nothing simulates."""
    names: list[str] = []

    def place(field: str) -> int:
        if field not in names:
            names.append(field)
        return names.index(field)

    unknown = set(roles.conditions) - {"case_degC", "supply_V"}
    unknown |= {name for number in sensors for name in roles.sensors[number].conditions} - {"spin_period_us"}
    if unknown:
        raise InputError(
            f"the simulated unit has no {', '.join(sorted(unknown))}; take it out of the description's roles"
        )
    accelerations = {n: one.acceleration_fields.values() for n, one in sensors.items()}
    return FieldColumns(
        rates={n: _together([place(field) for field in one.rate_fields]) for n, one in sensors.items()},
        accelerations={n: _together([place(field) for field in fields]) for n, fields in accelerations.items()},
        rotors={n: place(one.temperature_field) for n, one in sensors.items() if one.temperature_field},
        spins={n: place(one.spin_field) for n, one in sensors.items() if one.spin_field},
        case=place(roles.conditions["case_degC"]) if "case_degC" in roles.conditions else None,
        supply=place(roles.conditions["supply_V"]) if "supply_V" in roles.conditions else None,
        names=tuple(names),
    )


class Supply:
    """What one unit is supplied with at the grid points, V: it wanders."""

    def __init__(self, settings: SimulationSection, session: int) -> None:
        self._nominal, self._stream = settings.supply, stream(settings.seed, SUPPLY, session)
        self._keep = float(np.exp(-GRID_S / _SUPPLY_LAG_S))
        self._kick = settings.noise.supply_wander * float(np.sqrt(1.0 - self._keep**2))
        self._table = GrowingTable(1)  # by how much it departs from the nominal

    def at(self, nodes: NDArray[np.int64]) -> FloatArray:
        """Return it at rising grid points, (n,), n ≥ 1."""
        known = self._table.rows
        if (lacking := int(nodes[-1]) + 1 - len(known)) > 0:
            steps = self._kick * self._stream.standard_normal((lacking, 1))
            self._table.append(correlated(self._keep, steps, known[-1] if len(known) else np.zeros(1)))
        return self._nominal + self._table.at(nodes)[:, 0]


class SlowGrid:
    """The grid points up to now, of units of one kind in one air. Every table has one row for each; slopes are per s.

    Temperatures are kept for as long as the unit lives: tests ask what it really was. What only samples are
    made of is kept for an hour after each unit asked last: time never goes backwards.
    """

    def __init__(
        self,
        sensors: Mapping[int, SimulatedSensor],
        columns: FieldColumns,
        settings: SimulationSection,
        thermal: ThermalUnit,
        *,
        begins_s: float,
        sample_rate_hz: float,
    ) -> None:
        self._sensors, self._columns, self._settings, self._thermal = sensors, columns, settings, thermal
        self._begins_s = begins_s
        self._root_rate = float(np.sqrt(sample_rate_hz))
        fields = len(columns.names)
        # Every field but rates and accelerations, without noise; its slope; each field's white noise per sample.
        self.level, self.slope, self.sigma = (GrowingTable(fields) for _ in range(3))
        self._state, self.state_slope = GrowingTable(3), GrowingTable(2)  # slopes of case and rotor, °C/s
        # Bias and K of each sensor (see `SimulatedSensor.coefficients`), then their slopes.
        self.coefficients = {n: GrowingTable(8 * one.channels) for n, one in sensors.items()}
        self._asked: dict[object, int] = {}  # how many points there were when each unit asked last
        self._known: dict[object, tuple[object, Any]] = {}

    def advance(self, to_s: float, unit: object) -> None:
        """Add the grid points up to `to_s`, for which a `unit` asks."""
        self._asked[unit] = len(self._state.rows)
        if math.floor((to_s - self._begins_s) / GRID_S) < len(self._state.rows):
            return
        _, state, slopes = self._thermal.advance(to_s)
        oldest = min(self._asked.values()) - _KEPT
        for table in (self.level, self.slope, self.sigma, *self.coefficients.values()):
            table.drop_before(oldest)
        self._state.append(state)
        self.state_slope.append(slopes)
        for number, one in self._sensors.items():
            now = one.coefficients(state[:, ROTOR])
            then = one.coefficients(state[:, ROTOR] + GRID_S * slopes[:, 1])
            self.coefficients[number].append(np.hstack([now, (then - now) / GRID_S]))
        self._append_fields(state, slopes)

    def once(self, what: object, key: object, made: Callable[[], _Made]) -> _Made:
        """Return what the units have in common at a poll, `made` for the first that asks with this `key`."""
        if self._known.get(what, (None,))[0] != key:
            self._known[what] = key, made()
        found: _Made = self._known[what][1]
        return found

    def between(self, times_s: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray, FloatArray]:
        """Return of times (n,) the grid points before, s since, (n,) each; noises and values, (n, fields) each."""
        nodes = self.nodes(times_s)
        since_s = times_s - self.time_of(nodes)
        return nodes, since_s, self.sigma.at(nodes), self.level.at(nodes) + self.slope.at(nodes) * since_s[:, None]

    def nodes(self, times_s: FloatArray) -> NDArray[np.int64]:
        """Return the number of the grid point at or before each time, (n,); the first one for earlier times."""
        return np.maximum(np.floor((times_s - self._begins_s) / GRID_S).astype(np.int64), 0)

    def time_of(self, nodes: NDArray[np.int64]) -> FloatArray:
        """Return the times of grid points, s, (n,)."""
        return np.asarray(self._begins_s + GRID_S * nodes)

    @property
    def state(self) -> FloatArray:
        """Temperatures of air, case and rotor, °C, (m, 3)."""
        return self._state.rows

    def conditions(self, sensor: int, nodes: NDArray[np.int64]) -> dict[str, FloatArray]:
        """Return the spin period at grid points, (n,), by campaign column name, where it is simulated."""
        place = self._columns.spins.get(sensor)
        return {} if place is None else {"spin_period_us": self.level.at(nodes)[:, place]}

    def _append_fields(self, state: FloatArray, slopes: FloatArray) -> None:
        columns, noise = self._columns, self._settings.noise
        level, slope, sigma = (np.zeros((len(state), len(columns.names))) for _ in range(3))
        for number, one in self._sensors.items():
            white = 60.0 * one.noise.angle_random_walk.at(state[:, ROTOR])  # deg/hr per √Hz, of deg/√hr
            sigma[:, columns.rates[number]] = self._root_rate * white[:, None]
            sigma[:, columns.accelerations[number]] = noise.accelerometers
        thermometers = [(column, ROTOR) for column in columns.rotors.values()]
        thermometers += [(columns.case, CASE)] if columns.case is not None else []
        for column, node in thermometers:
            level[:, column], slope[:, column] = state[:, node], slopes[:, node - 1]
            sigma[:, column] = noise.thermometers
        for place, column in enumerate(columns.spins.values()):
            period = _SPIN_US + place * _SPIN_STEP_US
            level[:, column] = period * (1.0 + _SPIN_PER_DEGC * (state[:, ROTOR] - _REFERENCE_DEGC))
            sigma[:, column] = _SPIN_SIGMA_US
        if columns.supply is not None:
            sigma[:, columns.supply] = noise.supply
        self.level.append(level)
        self.slope.append(slope)
        self.sigma.append(sigma)
