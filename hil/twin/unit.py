"""The simulated unit: what its fields read at any moment, from the equation, its temperatures and its noise.

It implements `drivers.simulators.unit.UnitPhysics`: the simulator of the frames asks it for signals by field name, and
it knows nothing of bytes. Times never go backwards, and every sample is asked for once; how many are asked for at a
time changes nothing, not even the last bit.

Everything that moves slowly is known on a grid with its slope (`hil.twin.grid`); a sample is the value at the grid
point before it, along the slope, plus white noise. The rates are R = B + K·f + w at the unit's orientation.

The model's named effects add terms to the mean, and scatter; both may depend on anything that a campaign knows. Terms
may depend on the past (hysteresis, a setpoint's step, the positions before), so they are evaluated in groups of grid
points, five minutes each, with a history of one row per stay and group before. A grid point is the mean over its 5 s.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from drivers.frames.roles import Roles
from drivers.simulators.chambers.plant import ChamberPlant
from hil.campaign import Conditions, FloatArray
from hil.config.bench import Bench
from hil.errors import InputError
from hil.model import Model
from hil.model.effects.base import VarianceEffect
from hil.model.effects.history import joined
from hil.model.effects.scatter import Scatter
from hil.twin.grid import CASE, ROTOR, FieldColumns, SlowGrid, Supply, field_columns
from hil.twin.motion import FROM_THE_START, Leg, Resumed, Timeline
from hil.twin.scatter import WHITE, NamedNoise, stream
from hil.twin.sensor import SimulatedSensor, simulation_of
from hil.twin.thermal import GRID_S, ThermalUnit

_COLD_DEGC = 5.0  # below it the bearings settle slowly
_SETTLED_AFTER = 25.0  # time constants after which nothing is left of the settling
_GROUP = 60  # grid points per evaluation of terms: five minutes
_SPAN_S = 2.0 * 86400.0  # for which 1/f noise is made of processes: a long night
_DEG_PER_HR = float(np.rad2deg(1.0)) * 3600.0


class SimulatedUnit:
    """The physics of the simulated unit, in a night that may have been `resumed`.

    A unit that is `alike` in all but its seed, in the same air, shares what moves slowly.

    Raises `InputError` where the bench has no simulation or begins at a position that it does not have, or a term of
    the model needs a condition that is not simulated.
    """

    def __init__(
        self,
        bench: Bench,
        model: Model,
        roles: Roles,
        plant: ChamberPlant,
        *,
        sample_rate_hz: float,
        begins_s: float = 0.0,
        resumed: Resumed = FROM_THE_START,
        alike: SimulatedUnit | None = None,
    ) -> None:
        settings, session = simulation_of(bench), resumed.session
        if settings.start.position not in bench.positions:
            raise InputError(
                f"{bench.source or bench.name}: simulation.start.position: there is no position "
                f"{settings.start.position!r}; allowed: {', '.join(bench.positions)}"
            )
        self._settling, self._session = settings.settling, session
        self._gravity, self._earth_rate = bench.site.gravity_g(), bench.site.earth_rate_deg_per_hr()
        self._sensors = {n: SimulatedSensor(bench, n, roles.sensors[n], model) for n in sorted(bench.sensors)}
        self._columns: FieldColumns = field_columns(self._sensors, roles)
        if alike:
            self._grid: SlowGrid = alike._grid
        else:
            begins = {"start_degC": settings.start.temperature, "powered_for_s": settings.start.powered_for}
            thermal = ThermalUnit(settings.thermal, plant.air_degC, begins_s=begins_s, **begins)
            timing = {"begins_s": begins_s, "sample_rate_hz": sample_rate_hz}
            self._grid = SlowGrid(self._sensors, self._columns, settings, thermal, **timing)
        self._supply = None if self._columns.supply is None else Supply(settings, session)
        self._rests: dict[tuple[int, int], tuple[Rest, FloatArray]] = {}  # until the next move
        orientations, rest_s = {n: bench.sensors[n].built for n in self._sensors}, settings.noise.new_run_after_rest
        start = settings.start.position
        self._timeline = Timeline(orientations, start, resumed=resumed, new_run_after_s=rest_s)
        self._white = stream(settings.seed, WHITE, session)  # in the order of the samples
        spun_up_s = begins_s - settings.start.powered_for
        self._rows = {n: GridRows(one, self._grid, self._supply, spun_up_s, plant) for n, one in self._sensors.items()}
        self._terms = {n: TermRates(rows) for n, rows in self._rows.items() if model.terms_for(rows.sensor.sensor)}
        self._scatters = [n for n, one in self._sensors.items() if one.scattering]
        self._scatter: dict[int, ScatterRates] = {}  # once there is a grid point
        self._streams = settings.seed, session, sample_rate_hz
        self._grid.advance(begins_s, self)
        for number in self._terms:  # or the night would end at its first sample
            model.rates(self._rows[number].at(self._rest(number, self._timeline.legs[0]), np.zeros(1, dtype=np.int64)))

    def start_move(self, position: str, begins_s: float, ends_s: float) -> None:
        """Turn to `position` from `begins_s` to `ends_s`; a move that takes no time says where the unit is at first."""
        if ends_s <= begins_s:
            self._timeline.place(position)
            return
        self._grid.advance(begins_s, self)
        node = min(int(self._grid.nodes(np.array([begins_s]))[0]), len(self._grid.state) - 1)
        rotor_degC = float(self._grid.state[node, ROTOR])
        settling = self._settling
        time_constant_s = settling.time_constant_cold if rotor_degC < _COLD_DEGC else settling.time_constant
        leg = self._timeline.add(position, begins_s, ends_s, time_constant_s)
        self._rests.clear()
        for sensor in self._sensors.values():
            sensor.begin_stay(self._session, leg, rotor_degC)

    def signals(self, times_s: FloatArray) -> Mapping[str, FloatArray]:
        """Return every field's readings at rising times, each of shape (n,), in the unit of its field."""
        times = np.asarray(times_s, dtype=np.float64)
        readings = self._white.standard_normal((len(times), len(self._columns.names)))
        if len(times):
            self._grid.advance(float(times[-1]), self)
            for n in set(self._scatters) - set(self._scatter):
                rest = self._rest(n, self._timeline.legs[0])
                self._scatter[n] = ScatterRates(self._rows[n], rest, *self._streams)
            white = {n: one.white(len(times)) for n, one in self._scatter.items()}
            poll = float(times[0]), float(times[-1]), len(times)
            nodes, since_s, sigma, slow = self._grid.once("fields", poll, lambda: self._grid.between(times))
            readings *= sigma
            readings += slow
            if self._supply is not None:
                readings[:, self._columns.supply] += self._supply.at(nodes)
            for leg, moving, part in self._timeline.parts(times):
                drawn = {n: [each[part] for each in own] for n, own in white.items()}
                here = _Part(leg, times[part], nodes[part], since_s[part], readings[part], drawn)
                for number in self._sensors:
                    (self._turn if moving else self._stay)(number, here)
        return {name: readings[:, column] for column, name in enumerate(self._columns.names)}

    def _rest(self, number: int, leg: Leg) -> Rest:
        axes = leg.stop[number]
        return Rest(leg, axes @ self._gravity, axes @ self._earth_rate)

    def _stay(self, number: int, here: _Part) -> None:
        """Add rates and accelerations of a sensor that rests at its position."""
        one, leg = self._sensors[number], here.leg
        if (number, leg.number) not in self._rests:
            rest = self._rest(number, leg)
            self._rests[number, leg.number] = rest, one.rates(one.scatter_coefficients(leg)[None], rest.f_g)
        rest, own = self._rests[number, leg.number]
        first, last = int(here.nodes[0]), int(here.nodes[-1])
        at, risen = here.nodes - first, np.zeros(1)
        if number in self._terms:
            level = self._terms[number].rates(rest, first, last)[at]
        else:
            key = float(here.times_s[0]), float(here.times_s[-1]), len(at), leg.position
            level, risen = self._grid.once(number, key, lambda: self._at_rest(number, rest, here))
        rates = level + own
        named: list[FloatArray] = []
        if number in self._scatter:
            wandered, named = self._scatter[number].rates(rest, first, last)
            rates += wandered[at]
        rates += risen
        for columns, drawn in zip(named, here.white.get(number, ()), strict=True):
            rates += np.einsum("ncp,np->nc", columns[at], drawn)
        rates += _settling(leg, self._settling.size, here.times_s)
        here.readings[:, self._columns.rates[number]] += rates
        here.readings[:, self._columns.accelerations[number]] += rest.f_g[one.acceleration_axes]

    def _at_rest(self, number: int, rest: Rest, here: _Part) -> tuple[FloatArray, FloatArray]:
        """Return the rates at the grid points before samples at rest, (n, c), deg/hr, and what they rose since."""
        one, first, last = self._sensors[number], int(here.nodes[0]), int(here.nodes[-1])
        known = self._grid.coefficients[number].between(first, last)
        now, then = known[:, : 4 * one.channels], known[:, 4 * one.channels :]
        level, slope = one.rates(now, rest.f_g, rest.w_deg_per_hr[one.sensor.channel_axes]), one.rates(then, rest.f_g)
        at = here.nodes - first
        return level[at], slope[at] * here.since_s[:, None]

    def _turn(self, number: int, here: _Part) -> None:
        """Add rates and accelerations of a sensor that is being turned: it sees the motion itself."""
        one = self._sensors[number]
        turn, motion = here.leg.turned(here.times_s)
        axes = here.leg.start[number] @ turn.as_matrix().swapaxes(-1, -2)
        f_g, w = axes @ self._gravity, axes @ self._earth_rate
        rotation = np.einsum("nij,nj->ni", axes, motion) * _DEG_PER_HR
        known = self._grid.coefficients[number].at(here.nodes)
        coefficients = known[:, : 4 * one.channels] + known[:, 4 * one.channels :] * here.since_s[:, None]
        turning = (w + rotation)[:, one.sensor.channel_axes]
        rates = one.rates(coefficients + one.scatter_coefficients(here.leg), f_g, turning)
        here.readings[:, self._columns.rates[number]] += rates
        here.readings[:, self._columns.accelerations[number]] += f_g[:, one.acceleration_axes]


@dataclass(frozen=True)
class _Part:
    """Samples that belong to one move or one stay: their times, grid points and readings (which are added to)."""

    leg: Leg
    times_s: FloatArray
    nodes: NDArray[np.int64]
    since_s: FloatArray
    readings: FloatArray
    white: Mapping[int, Sequence[FloatArray]]  # by sensor: coefficients of what is white, (n, p) each


def _settling(leg: Leg, size: float, times_s: FloatArray) -> FloatArray:
    """Return what is left of the settling after the move, deg/hr, shape (n, 1): it dies away exponentially."""
    if leg.settling_s <= 0.0 or times_s[0] - leg.ends_s > _SETTLED_AFTER * leg.settling_s:
        return np.zeros((1, 1))
    decay = np.exp(-(times_s - leg.ends_s) / leg.settling_s)
    return np.asarray(size * decay)[:, None]


@dataclass(frozen=True)
class Rest:
    """Where a sensor rests: since which move, and gravity and earth rate along its axes, (3,) each."""

    leg: Leg
    f_g: FloatArray
    w_deg_per_hr: FloatArray


class GridRows:
    """What a campaign would know of a sensor at grid points."""

    def __init__(
        self, sensor: SimulatedSensor, grid: SlowGrid, supply: Supply | None, spun_up_s: float, plant: ChamberPlant
    ) -> None:
        self.sensor, self.grid, self._supply = sensor, grid, supply
        self._spun_up_s, self._plant = spun_up_s, plant
        self.begins_s = float(grid.time_of(np.array([0]))[0])

    def at(self, here: Rest, nodes: NDArray[np.int64]) -> Conditions:
        """Return one row for each grid point, (m,), of a sensor that rests."""
        begins_s = self.grid.time_of(nodes)
        state, slopes = self.grid.state[nodes], self.grid.state_slope.at(nodes)
        half, known = 0.5 * GRID_S, bool(np.isfinite(here.leg.ends_s))
        columns = {
            "temperature_degC": state[:, ROTOR] + half * slopes[:, 1],
            "case_degC": state[:, CASE] + half * slopes[:, 0],
            "chamber_degC": state[:, 0],
            "dTdt_degC_per_min": 60.0 * slopes[:, 1],
            "time_since_power_on_s": begins_s - self._spun_up_s,
            "time_since_index_s": np.maximum(begins_s - here.leg.ends_s, 0.0) if known else np.full(len(nodes), np.nan),
            **({} if self._supply is None else {"supply_V": self._supply.at(nodes)}),
            **self.grid.conditions(self.sensor.sensor.number, nodes),
        }
        setpoint, columns["time_since_setpoint_s"] = self._plant.setpoint_at(begins_s)
        # Before the first a unit stands in air as it is: the first is a step from there.
        columns["setpoint_degC"] = np.where(np.isfinite(setpoint), setpoint, state[:, 0])
        n = len(nodes)
        return Conditions(
            self.sensor.sensor,
            collect=np.full(n, here.leg.number),
            run=np.full(n, here.leg.run - (not known)),  # before the first move none has begun
            position=np.full(n, here.leg.position),
            start_s=begins_s,
            duration_s=np.full(n, GRID_S),
            f_g=np.tile(here.f_g, (n, 1)),
            w_deg_per_hr=np.tile(here.w_deg_per_hr, (n, 1)),
            columns=columns,
        )


class TermRates:
    """Rates of one sensor at its orientation, from `Model.rates`."""

    def __init__(self, rows: GridRows) -> None:
        self._rows = rows
        self._history: Conditions | None = None  # the first grid point of every group that is over, and of every stay
        self._known = 0  # of the grid points before this one, nothing more will be remembered
        self._here: Rest | None = None

    def rates(self, here: Rest, first: int, last: int) -> FloatArray:
        """Return the mean rates over grid points `first` to `last` (inclusive) while resting, shape (m, c), deg/hr."""
        stands = int(self._rows.grid.nodes(np.array([max(here.leg.ends_s, self._rows.begins_s)]))[0])
        if self._here is None or here.leg is not self._here.leg:
            self._remember(self._here or here, stands)
            self._add(here, stands)
            self._here, self._known = here, stands + 1
        parts = []
        for group in range(first // _GROUP, last // _GROUP + 1):
            begin, end = max(group * _GROUP, stands), min(last, group * _GROUP + _GROUP - 1)
            # From the group's or the stay's beginning even where only the end is asked for: an effect that remembers
            # must meet the same past however often it is asked.
            self._remember(here, begin)
            rows = self._rows.at(here, np.arange(begin, end + 1))
            past = self._history and self._history.rows(self._history.start_s < rows.start_s[0])
            parts.append(self._rows.sensor.model.rates(rows, past)[max(first - begin, 0) :])
        return np.concatenate(parts)

    def _remember(self, here: Rest, until: int) -> None:
        for node in range(-(-self._known // _GROUP) * _GROUP, until, _GROUP):
            self._add(here, node)
        self._known = max(self._known, until)

    def _add(self, here: Rest, node: int) -> None:
        row = self._rows.at(here, np.array([node]))
        self._history = row if self._history is None else joined(self._history, row)


class ScatterRates:
    """What the model's named effects scatter a sensor's rates by: each is drawn as its own `Scatter` says."""

    def __init__(self, rows: GridRows, here: Rest, seed: int, session: int, sample_rate_hz: float) -> None:
        self._rows, self._terms = rows, rows.sensor.scattering
        self._per_sample = float(np.sqrt(GRID_S * sample_rate_hz))  # of white noise that is of unit size over 5 s
        self._noises: list[NamedNoise] = []
        self._white: list[NamedNoise] = []
        number, met = rows.sensor.sensor.number, Counter[tuple[int, int]]()
        for effect, _, part in self._parts(here, np.zeros(2, dtype=np.int64)):
            # One cause that moves both sensors has the same coefficients in each.
            name = (0 if effect.common_to_sensors else number, crc32(effect.id.encode()))
            self._noises.append(NamedNoise(seed, session, (*name, met[name]), part))
            self._white += self._noises[-1:] if part.is_white else []
            met[name] += 1

    def white(self, samples: int) -> list[FloatArray]:
        """Return the coefficients of what is white for the next samples, (samples, p) each, in time order."""
        return [noise.of_samples(samples) for noise in self._white]

    def rates(self, here: Rest, first: int, last: int) -> tuple[FloatArray, list[FloatArray]]:
        """Return resting rates at grid points `first` … `last`, (m, c), deg/hr, and `white`'s columns, (m, c, p)."""
        level, white = np.zeros((last + 1 - first, self._rows.sensor.channels)), []
        for noise, (_, size, part) in zip(self._noises, self._parts(here, np.arange(first, last + 1)), strict=True):
            columns = part.columns[1:-1] * size[:, None, None]
            if noise in self._white:
                white.append(columns * self._per_sample ** (2 if part.of_angle else 1))
                continue
            drawn = noise.on_grid(first, last) if part.group is None else noise.of_groups(part.group[1:-1])
            level += np.einsum("ncp,np->nc", columns, drawn)
        return level, white

    def _parts(self, here: Rest, nodes: NDArray[np.int64]) -> Iterator[tuple[VarianceEffect, FloatArray, Scatter]]:
        """Yield every part with its effect and its size at m grid points, (m,); its own rows have one more each end.

        Those two stand where the night begins and where a long one ends: 1/f noise depends on how long one looks.
        """
        rows = self._rows.at(here, nodes[[0, *range(len(nodes)), -1]])
        start_s = rows.start_s.copy()
        start_s[[0, -1]] = self._rows.begins_s, self._rows.begins_s + _SPAN_S
        rows = replace(rows, start_s=start_s)
        for term, effect in self._terms:
            size = term.size_at(rows.columns["temperature_degC"][1:-1])
            for part in term.of_unit_size(rows):
                yield effect, size, part
