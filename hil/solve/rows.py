"""A campaign as independent blocks of rows: the unit on which noise and evidence are computed.

A block is the rows of one channel of one sensor, with the columns of the base model that act on it. Channels whose base
columns cannot be separated (a rotor sensor whose B direction is excited: GSA and GSB act on both channels) form one
block. Blocks share no base parameter, so that each has its own noise.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.campaign import BoolArray, Collects, FloatArray, IntArray
from hil.solve.identifiability import (
    CANNOT_BE_SEEN,
    independent_columns,
    kept_shares,
    linked_groups,
    orthonormal,
    project_out,
)
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
    measured = np.isfinite(rates)
    groups = _coupled_channels(base, measured)
    rms = np.sqrt(np.mean(base**2, axis=0))  # (c, p); of a group are the columns that are as large there as anywhere
    acting = [rms[group].max(axis=0) > 0.2 * rms.max(axis=0) for group in groups]
    if len(groups) > 1:  # what unexcited shared columns contribute, from one joint fit, is taken off, not fitted twice
        fit = np.linalg.lstsq(base[measured], rates[measured], rcond=1e-6)[0]
        for group, own in zip(groups, acting, strict=True):
            rates[:, group] -= base[:, group][..., ~own] @ fit[~own]
    conditions, stated = collects.conditions, collects.rates_se_deg_per_hr
    places = {run: k for k, run in enumerate(dict.fromkeys(conditions.run.tolist()))}
    order, station = np.array([places[run] for run in conditions.run.tolist()]), same_temperature(conditions)
    blocks = []
    for group, own in zip(groups, acting, strict=True):
        place, row = np.nonzero(measured[:, group].T)  # channel by channel
        channel = np.array(group)[place]
        sigma = stated[row, channel]
        told = bool(np.all(sigma > 0.0))
        columns = independent_columns(base[row, channel][:, own])
        white = sigma if told else np.ones(len(sigma))
        blocks.append(Block(number, row, channel, rates[row, channel], columns, white, told, order[row], station[row]))
    return blocks


def _coupled_channels(base: FloatArray, measured: BoolArray) -> list[list[int]]:
    """Group channels that a base column moves, each beyond what the columns of that channel alone can absorb."""
    acts = np.any(base, axis=0)  # (c, p)
    shared = acts.sum(axis=0) > 1
    least, excited = _UNEXCITED * np.abs(base[..., shared]).max(axis=(0, 1)), []
    for columns, rows, own in zip(np.swapaxes(base, 0, 1), measured.T, acts, strict=True):
        left = project_out(orthonormal(columns[rows][:, own & ~shared]), columns[rows][:, shared])
        excited.append(np.linalg.norm(left, axis=0) > least * np.sqrt(rows.sum()))
    return linked_groups(np.array(excited) @ np.array(excited).T, np.ones(len(acts), np.bool_))
