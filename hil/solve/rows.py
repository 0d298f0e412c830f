"""A campaign as independent blocks of rows: the unit on which noise and evidence are computed.

A block is the rows of one channel of one sensor, with the columns of the base model that act on it. Channels whose base
columns cannot be separated (a rotor sensor whose B direction is excited: GSA and GSB act on both channels) form one
block. Blocks share no base parameter, so that each has its own noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.campaign import Collects, FloatArray, IntArray
from hil.solve.identifiability import CANNOT_BE_SEEN, independent_columns, kept_shares, orthonormal, project_out
from hil.solve.observability import linked_groups
from hil.solve.temperatures import same_temperature

_UNEXCITED = 0.05  # a column smaller than this beside the channel's own columns does not couple two channels


@dataclass(frozen=True)
class Block:
    """Rows of one block.

    `rows` (N,) index the sensor's collects and `channel` (N,) its channels; `y` (N,) is the measured rate less what the
    model takes as known, deg/hr; `base` (N, p) the base columns that act here; `sigma` (N,) the stated white noise
    (ones where nothing is stated); `run` (N,) the place of the row's run in the order of runs; `station` (N,) the
    number of its temperature.
    """

    sensor: int
    rows: IntArray
    channel: IntArray
    y: FloatArray
    base: FloatArray
    sigma: FloatArray
    sigma_stated: bool
    run: IntArray
    station: IntArray

    def select(self, columns: FloatArray) -> FloatArray:
        """Return (n, c, p) columns of the sensor at this block's rows, shape (N, p)."""
        return np.asarray(columns[self.rows, self.channel])

    @cached_property
    def values(self) -> FloatArray:
        """The base's columns that are values at one temperature, (N, v); its laws of temperature are none."""
        kept: list[int] = []
        for place, column in enumerate(self.base.T):
            known = orthonormal(self.at_each_temperature(self.base[:, kept]))
            if kept_shares(known, column[:, None])[0] > CANNOT_BE_SEEN:
                kept.append(place)
        return self.base[:, kept]

    def at_each_temperature(self, columns: FloatArray) -> FloatArray:
        """Return columns (N, v) anew at each of S temperatures, (N, v·S)."""
        at = np.equal.outer(self.station, np.unique(self.station)).astype(np.float64)
        return np.asarray((columns[:, :, None] * at[:, None, :]).reshape(len(self.y), -1))


def sensor_blocks(number: int, collects: Collects, known: FloatArray, base: FloatArray) -> list[Block]:
    """Split one sensor's collects into blocks.

    `known` (n, c) is what the model takes as given (earth rate, valued terms), `base` (n, c, p) its fitted columns.
    Rows without a rate are left out; a sensor whose channels share an excited base column is one block.
    """
    rates = collects.rates_deg_per_hr - known
    channels = list(range(rates.shape[1]))
    groups = _coupled_channels(base, np.isfinite(rates)) if base.shape[2] else [[channel] for channel in channels]
    rates = rates - _small_couplings(base, rates, groups)
    return [_block(number, collects, rates, base, group) for group in groups]


def _coupled_channels(base: FloatArray, measured: FloatArray) -> list[list[int]]:
    """Group channels that share an excited base column."""
    _, channels, columns = base.shape
    acting = [[_is_excited(base, measured, column, c) for column in range(columns)] for c in range(channels)]
    return linked_groups(np.array(acting) @ np.array(acting).T, np.ones(channels, np.bool_))


def _is_excited(base: FloatArray, measured: FloatArray, column: int, channel: int) -> bool:
    """Whether a base column moves a channel beyond what the columns of that channel alone can absorb."""
    rows = measured[:, channel]
    target = base[rows, channel, column]
    if not np.any(target):
        return False
    largest = np.abs(base[:, :, column]).max()
    own = [k for k in range(base.shape[2]) if k != column and _only_here(base, k, channel)]
    remainder = target
    if own:
        remainder = project_out(orthonormal(base[rows, channel][:, own]), target)
    return bool(np.sqrt(np.mean(remainder**2)) > _UNEXCITED * largest)


def _only_here(base: FloatArray, column: int, channel: int) -> bool:
    others = [c for c in range(base.shape[1]) if c != channel]
    return bool(np.any(base[:, channel, column])) and not np.any(base[:, others, column])


def _small_couplings(base: FloatArray, rates: FloatArray, groups: Sequence[Sequence[int]]) -> FloatArray:
    """What unexcited shared columns contribute, from one joint fit, shape (n, c): taken off once, not fitted twice."""
    out = np.zeros_like(rates)
    if base.shape[2] == 0 or all(len(group) == rates.shape[1] for group in groups):
        return out
    finite = np.isfinite(rates)
    fit = np.linalg.lstsq(base[finite], rates[finite], rcond=1e-6)[0]
    for group in groups:
        for channel in group:
            for column in range(base.shape[2]):
                if not _acts_on(base, column, group) and np.any(base[:, channel, column]):
                    out[:, channel] += base[:, channel, column] * fit[column]
    return out


def _acts_on(base: FloatArray, column: int, group: Sequence[int]) -> bool:
    """Whether a base column belongs to this group of channels: it is as large here as anywhere."""
    here = np.sqrt(np.mean(base[:, list(group), column] ** 2, axis=0)).max()
    anywhere = np.sqrt(np.mean(base[:, :, column] ** 2, axis=0)).max()
    return bool(here > 0.2 * anywhere)


def _block(number: int, collects: Collects, rates: FloatArray, base: FloatArray, group: Sequence[int]) -> Block:
    conditions = collects.conditions
    own = [k for k in range(base.shape[2]) if _acts_on(base, k, group)]
    place, row = np.nonzero(np.isfinite(rates[:, list(group)]).T)  # channel by channel
    chan = np.array(group, dtype=np.int64)[place]
    run_order = {run: place for place, run in enumerate(dict.fromkeys(conditions.run.tolist()))}
    order = np.array([run_order[run] for run in conditions.run.tolist()], dtype=np.int64)
    station = same_temperature(conditions)
    sigma = collects.rates_se_deg_per_hr[row, chan]
    stated = bool(np.all(sigma > 0.0))
    return Block(
        sensor=number,
        rows=row,
        channel=chan,
        y=rates[row, chan],
        base=independent_columns(base[row, chan][:, own]),
        sigma=sigma if stated else np.ones(len(sigma)),
        sigma_stated=stated,
        run=order[row],
        station=station[row],
    )
