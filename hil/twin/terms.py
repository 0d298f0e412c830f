"""What the model's named effects do to a simulated sensor at rest: terms on the mean, and scatter.

Both may depend on anything that a campaign knows. The mean comes from the model itself; its terms may depend on the
past (hysteresis, a setpoint's step, the positions before), so they are evaluated in groups of grid points, five minutes
each, with a history of one row for every stay and every group before. Each grid point stands for the mean over its 5 s.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from drivers.simulators.chambers.plant import ChamberPlant
from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import VarianceEffect
from hil.model.effects.history import joined
from hil.model.effects.scatter import Scatter
from hil.twin.grid import CASE, ROTOR, SlowGrid, Supply
from hil.twin.motion import Leg
from hil.twin.scatter import NamedNoise
from hil.twin.sensor import SimulatedSensor
from hil.twin.thermal import GRID_S

_GROUP = 60  # grid points per evaluation: five minutes
_SPAN_S = 2.0 * 86400.0  # for which 1/f noise is made of processes: a long night


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
        """Return rates at grid points `first` to `last` (inclusive) while resting, (m, c), deg/hr; and what is white.

        The latter are the columns for the coefficients of `white`, (m, c, p) each.
        """
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
            for part in effect.scatter(rows, term.shape):
                yield effect, size, part
