"""Exchanged labels: two collects of one run that stand under each other's position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtri, ndtri

from hil.campaign import Campaign, Collects, Conditions, FloatArray, IntArray
from hil.reconcile.search.fit import estimate_noise
from hil.reconcile.search.scan import RESOLVED
from hil.solve.likelihood import NoiseTable
from hil.solve.rows import Block

_LEAST_GAIN = 12.0  # log likelihood; chance gives 5 over a hundred pairs
_PAIRS = 100.0
_MENDS = 1e-3  # what is left of exchanged collects may be as rare as this
_LEAST_RUNS = 4
_MOST_EXCHANGES = 3


@dataclass(frozen=True)
class Exchange:
    """Two collects of one run whose labels were exchanged.

    `rows` are their places among the sensor's collects and `collects` their numbers in the file, `gain` the log
    likelihood that putting them right is worth, `chance` a bound on how often noise alone offers as much among all the
    pairs that were tried.
    """

    sensor: int
    run: int
    rows: tuple[int, int]
    collects: tuple[int, int]
    positions: tuple[str, str]
    gain: float
    chance: float


def exchanges(campaign: Campaign, blocks: Sequence[Block], tables: Sequence[NoiseTable]) -> list[Exchange]:
    """Return the pairs of labels in one run that were exchanged: with the rates in each other's place all fits well.

    Every run and pair is tried under the noise estimated as the data stand, which an exchange itself inflates: what is
    compared is the likelihood with the scale of each block refitted. Two glitches that fit a little better in each
    other's place are no exchange: that leaves nothing unusual in either collect.
    """
    found: list[Exchange] = []
    pairs = _pairs(campaign)
    least = _LEAST_GAIN + float(np.log(max(len(pairs) / _PAIRS, 1.0)))
    noise = [estimate_noise(block, table) for block, table in zip(blocks, tables, strict=True)]
    projectors = [n.projector(block.base) for block, n in zip(blocks, noise, strict=True)]
    y = [block.y for block in blocks]
    known = [_known(block, campaign) for block in blocks]
    while len(found) < _MOST_EXCHANGES:
        before = _log_likelihood(blocks, projectors, y)
        best: tuple[float, int, tuple[int, int], list[FloatArray]] | None = None
        for sensor, _, i, j in pairs:
            moved = _moved(blocks, y, known, sensor, (i, j))
            gain = _log_likelihood(blocks, projectors, moved) - before
            if best is None or gain > best[0]:
                best = (gain, sensor, (i, j), moved)
        if best is None or best[0] < least or not _is_mended(blocks, projectors, best[3], best[1], best[2]):
            break
        gain, sensor, rows, y = best
        chance = float(np.clip(len(pairs) * np.exp(-gain), RESOLVED, 1.0))
        found.append(_exchange(campaign.sensors[sensor].conditions, rows, gain, chance))
    return found


def _exchange(conditions: Conditions, rows: tuple[int, int], gain: float, chance: float) -> Exchange:
    i, j = rows
    return Exchange(
        sensor=conditions.sensor.number,
        run=int(conditions.run[i]),
        rows=rows,
        collects=(int(conditions.collect[i]), int(conditions.collect[j])),
        positions=(str(conditions.position[i]), str(conditions.position[j])),
        gain=gain,
        chance=chance,
    )


def _is_mended(
    blocks: Sequence[Block],
    projectors: Sequence[FloatArray],
    y: Sequence[FloatArray],
    sensor: int,
    pair: tuple[int, int],
) -> bool:
    """Whether two collects in each other's place are as the others predict them, all channels together.

    A channel that has a rate in one of the two only cannot show it.
    """
    squares, cells = 0.0, 0
    for block, projector, values in zip(blocks, projectors, y, strict=True):
        own = _of_both(block, pair) if block.sensor == sensor else np.zeros(0, dtype=np.int64)
        gradient = projector @ values
        score = gradient / np.sqrt(np.clip(np.diagonal(projector), 1e-12, None))
        scale = max(float(np.median(np.abs(score))) / float(ndtri(0.75)), 1e-12)
        inner = projector[np.ix_(own, own)]
        squares += float(gradient[own] @ np.linalg.pinv(inner, rcond=1e-6) @ gradient[own]) / scale**2
        cells += len(own)
    return squares < float(chdtri(max(cells, 1), _MENDS))


def _of_both(block: Block, pair: tuple[int, int]) -> IntArray:
    """The places of two collects in a block, in the channels that have a rate in both."""
    here = np.isin(block.rows, pair)
    full = [channel for channel in np.unique(block.channel) if np.sum(here & (block.channel == channel)) == len(pair)]
    return np.flatnonzero(here & np.isin(block.channel, full))


def _pairs(campaign: Campaign) -> list[tuple[int, int, int, int]]:
    """Sensor, run and the rows of every two collects of one run at different positions."""
    out = []
    for sensor, collects in campaign.sensors.items():
        runs = np.unique(collects.conditions.run)
        if len(runs) < _LEAST_RUNS:
            continue
        for run in runs.tolist():
            rows = np.flatnonzero(collects.conditions.run == run).tolist()
            labels = collects.conditions.position
            out += [(sensor, run, i, j) for i, j in combinations(rows, 2) if labels[i] != labels[j]]
    return out


def _log_likelihood(blocks: Sequence[Block], projectors: Sequence[FloatArray], y: Sequence[FloatArray]) -> float:
    """Log likelihood of all blocks with the scale of each refitted."""
    total = 0.0
    for block, projector, values in zip(blocks, projectors, y, strict=True):
        freedom = max(len(values) - block.base.shape[1], 1)
        total -= 0.5 * freedom * float(np.log(max(float(values @ projector @ values), 1e-12)))
    return total


def _known(block: Block, campaign: Campaign) -> FloatArray:
    """What was taken off the rates of a block as known, (N,): it belongs to the label, not to the rate."""
    return np.asarray(campaign.sensors[block.sensor].rates_deg_per_hr[block.rows, block.channel] - block.y)


def _moved(
    blocks: Sequence[Block], y: Sequence[FloatArray], known: Sequence[FloatArray], sensor: int, pair: tuple[int, int]
) -> list[FloatArray]:
    """The values of every block with the rates of two collects of a sensor in each other's place: its own inverse."""
    return [
        _exchanged(block, values, known[b], *pair) if block.sensor == sensor else values
        for b, (block, values) in enumerate(zip(blocks, y, strict=True))
    ]


def _exchanged(block: Block, values: FloatArray, known: FloatArray, i: int, j: int) -> FloatArray:
    """Rates with those of collects i and j in each other's place, what is known taken off where it belongs.

    A channel that has a rate in one of the two only stays as it is.
    """
    y = values.copy()
    for channel in np.unique(block.channel):
        a = np.flatnonzero((block.rows == i) & (block.channel == channel))
        b = np.flatnonzero((block.rows == j) & (block.channel == channel))
        if len(a) and len(b):
            step = known[a] - known[b]
            y[a], y[b] = values[b] - step, values[a] + step
    return y


def as_labelled(blocks: Sequence[Block], found: Sequence[Exchange], campaign: Campaign) -> list[Block]:
    """Return the blocks with every rate under the label that it has in the file.

    `blocks` are those of `campaign`, in which the exchanges are mended. Bases and rows stay as they are, so that folds
    and noise of the mended blocks serve; what was left out as an outlier stays out.
    """
    y = [block.y for block in blocks]
    known = [_known(block, campaign) for block in blocks]
    for exchange in reversed(found):
        y = _moved(blocks, y, known, exchange.sensor, exchange.rows)
    return [replace(block, y=values) for block, values in zip(blocks, y, strict=True)]


def mended(campaign: Campaign, found: Sequence[Exchange]) -> Campaign:
    """Return the campaign with exchanged rates put back in their places."""
    sensors = dict(campaign.sensors)
    for exchange in found:
        collects = sensors[exchange.sensor]
        rows = list(exchange.rows)
        rates, errors = collects.rates_deg_per_hr.copy(), collects.rates_se_deg_per_hr.copy()
        rates[rows], errors[rows] = rates[rows[::-1]], errors[rows[::-1]]
        sensors[exchange.sensor] = Collects(collects.conditions, rates, errors)
    return replace(campaign, sensors=sensors)
