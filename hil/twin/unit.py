"""The simulated unit: what its fields read at any moment, from the equation, its temperatures and its noise.

    unit = SimulatedUnit(bench, model, roles, plant, sample_rate_hz=20.0)
    unit.start_move("1", begins_s=100.0, ends_s=105.0)
    unit.signals(times_s)["rate_A2"]  # deg/hr, one per time

It implements `drivers.simulators.unit.UnitPhysics`: the simulator of the frames asks it for signals by field name, and
it knows nothing of bytes. Times never go backwards, and every sample is asked for once; how many are asked for at a
time changes nothing, not even the last bit.

Everything that moves slowly is known on a grid with its slope (`hil.twin.grid`); a sample is the value at the grid
point before it, along the slope, plus white noise. The rates are R = B + K·f + w at the unit's orientation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.frames.roles import Roles
from drivers.simulators.chambers.plant import ChamberPlant
from hil.campaign import FloatArray
from hil.config.bench import Bench
from hil.errors import InputError
from hil.model import Model
from hil.twin.grid import ROTOR, FieldColumns, SlowGrid, Supply, field_columns
from hil.twin.motion import FROM_THE_START, Leg, Resumed, Timeline
from hil.twin.scatter import WHITE, stream
from hil.twin.sensor import SimulatedSensor, simulation_of
from hil.twin.terms import GridRows, Rest, ScatterRates, TermRates
from hil.twin.thermal import ThermalUnit

_COLD_DEGC = 5.0  # below it the bearings settle slowly
_SETTLED_AFTER = 25.0  # time constants after which nothing is left of the settling
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
