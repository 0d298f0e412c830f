"""A campaign as independent blocks of rows: the unit on which noise and evidence are computed.

A block is the rows of one channel of one sensor, with the columns of the base model that act on it. Channels whose base
columns cannot be separated (a rotor sensor whose B direction is excited: GSA and GSB act on both channels) form one
block. Blocks share no base parameter, so that each has its own noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import Collects, Conditions, FloatArray, IntArray
from hil.solve.identifiability import independent_columns, orthonormal, project_out
from hil.solve.temperatures import same_temperature

_UNEXCITED = 0.05  # a column smaller than this beside the channel's own columns does not couple two channels
_WHITE_PRIOR_DOF = 10.0  # how strongly a temperature's own scatter is drawn to the campaign's


@dataclass(frozen=True)
class Block:
    """Rows of one block.

    `rows` (N,) index the sensor's collects and `channel` (N,) its channels; `y` (N,) is the measured rate less what the
    model takes as known, deg/hr; `base` (N, p) the base columns that act here; `sigma` (N,) the stated white noise
    (ones where nothing is stated); `run` (N,) the place of the row's run in the order of runs; `order` (N,) the place
    of the collect; `f_random` (N, k) the accelerations whose sensitivity may change from run to run. `sigma_trusted`
    says that the stated noise is all there is to judge by: nothing was measured twice.
    """

    sensor: int
    rows: IntArray
    channel: IntArray
    y: FloatArray
    base: FloatArray
    sigma: FloatArray
    sigma_stated: bool
    run: IntArray
    order: IntArray
    station: IntArray
    f_random: FloatArray
    sigma_trusted: bool = False

    def select(self, columns: FloatArray) -> FloatArray:
        """Return (n, c, p) columns of the sensor at this block's rows, shape (N, p)."""
        return np.asarray(columns[self.rows, self.channel])


def sensor_blocks(
    number: int, collects: Collects, known: FloatArray, base: FloatArray, *, as_stated: bool = False
) -> list[Block]:
    """Split one sensor's collects into blocks.

    `known` (n, c) is what the model takes as given (earth rate, valued terms), `base` (n, c, p) its fitted columns.
    Rows without a rate are left out; a sensor whose channels share an excited base column is one block. The white noise
    is weighed by each temperature's own scatter, unless it is to be `as_stated`.
    """
    conditions = collects.conditions
    rates = collects.rates_deg_per_hr - known
    channels = list(range(rates.shape[1]))
    groups = _coupled_channels(base, np.isfinite(rates)) if base.shape[2] else [[channel] for channel in channels]
    rates = rates - _small_couplings(base, rates, groups)
    blocks = [_block(number, collects, conditions, rates, base, group) for group in groups]
    if as_stated:
        return blocks
    return [replace(b, sigma=b.sigma * _station_scatter(b, conditions.f_g[b.rows])) for b in blocks]


def _coupled_channels(base: FloatArray, measured: FloatArray) -> list[list[int]]:
    """Group channels that share an excited base column."""
    n_channels = base.shape[1]
    group_of = list(range(n_channels))
    for column in range(base.shape[2]):
        acting = [c for c in range(n_channels) if _is_excited(base, measured, column, c)]
        for other in acting[1:]:
            group_of = [group_of[acting[0]] if g == group_of[other] else g for g in group_of]
    return [[c for c in range(n_channels) if group_of[c] == g] for g in sorted(set(group_of))]


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


def _block(
    number: int,
    collects: Collects,
    conditions: Conditions,
    rates: FloatArray,
    base: FloatArray,
    group: Sequence[int],
) -> Block:
    own = [k for k in range(base.shape[2]) if _acts_on(base, k, group)]
    rows, channel = [], []
    for c in group:
        measured = np.flatnonzero(np.isfinite(rates[:, c]))
        rows.append(measured)
        channel.append(np.full(len(measured), c))
    row, chan = np.concatenate(rows), np.concatenate(channel)
    run_order = {run: place for place, run in enumerate(dict.fromkeys(conditions.run.tolist()))}
    place = np.array([run_order[run] for run in conditions.run.tolist()], dtype=np.int64)
    station = same_temperature(conditions)
    sigma, stated = _stated_sigma(collects.rates_se_deg_per_hr[row, chan])
    random_axes = [2] if conditions.sensor.is_rotor else [0, 1, 2]
    return Block(
        sensor=number,
        rows=row,
        channel=chan,
        y=rates[row, chan],
        base=independent_columns(base[row, chan][:, own]),
        sigma=sigma,
        sigma_stated=stated,
        run=place[row],
        order=row,
        station=station[row],
        f_random=conditions.f_g[row][:, random_axes],
    )


def _stated_sigma(stated: FloatArray) -> tuple[FloatArray, bool]:
    """Return the white noise as stated, with a median where a cell is empty; ones where nothing is stated."""
    usable = np.isfinite(stated) & (stated > 0)
    if usable.sum() < 0.5 * len(stated):
        return np.ones(len(stated)), False
    return np.where(usable, stated, np.median(stated[usable])), True


def _station_scatter(block: Block, f_g: FloatArray) -> FloatArray:
    """Ratio of each temperature's own scatter to the campaign's, shape (N,), drawn towards one.

    Cold bearings scatter more. The scatter is that of the rates about each temperature's own fit of a constant per run
    and a slope per acceleration component, so that neither a missing effect nor a run-to-run bias is taken for noise.
    """
    numbers = np.unique(block.station)
    if len(numbers) < 2:
        return np.ones(len(block.y))
    squares, freedoms = {}, {}
    for number in numbers:
        here = block.station == number
        labels = [
            (block.channel[here] == c) & (block.run[here] == r)
            for c in np.unique(block.channel)
            for r in np.unique(block.run[here])
        ]
        design = np.hstack(
            [
                np.array(labels, dtype=np.float64).T,
                *(f_g[here] * (block.channel[here] == c)[:, None] for c in np.unique(block.channel)),
            ]
        )
        values = block.y[here] / block.sigma[here]
        design = design / block.sigma[here][:, None]
        fit, _, rank, _ = np.linalg.lstsq(design, values, rcond=1e-2)
        squares[number] = float(np.sum((values - design @ fit) ** 2))
        freedoms[number] = len(values) - int(rank)
    total = sum(freedoms.values())
    if total < 8:
        return np.ones(len(block.y))
    pooled = sum(squares.values()) / total
    ratio = {
        number: np.sqrt((_WHITE_PRIOR_DOF + squares[number] / pooled) / (_WHITE_PRIOR_DOF + freedoms[number]))
        for number in numbers
    }
    return np.array([ratio[number] for number in block.station.tolist()])


def is_repeated(blocks: Sequence[Block]) -> bool:
    """Whether some setpoint was visited by more than one run, so that a run can be held out."""
    return any(len(np.unique(block.run[block.station == k])) > 1 for block in blocks for k in np.unique(block.station))
