"""Rows that no model of the unit could explain: glitches, and labels that were exchanged.

Each row, and each collect of all channels together, is judged by its prediction from all other rows under the estimated
noise (externally studentised). What stands out is reported and left out of the search, at most a tenth of the rows.
Where two positions of one run stand out and exchanging their labels mends both, the labels were exchanged: that is a
finding of its own, and it is mended, not left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.special import chdtri, ndtri, stdtr

from hil.campaign import Campaign, Collects, Conditions, FloatArray, IntArray
from hil.reconcile.blocks import Block
from hil.reconcile.evidence import NoiseTable
from hil.reconcile.fit import BlockNoise, estimate_noise
from hil.reconcile.search import RESOLVED

_SHARE = 0.1
_LEVEL = 0.002  # familywise, of declaring any outlier in clean data
_LEAST_SCORE = 4.5
BEYOND_SCORES = 1e6
_GROSS = 1e4  # times the median departure: no rate of this unit, whatever is missing
_ROUNDING = 1e-9
_ALIKE = 0.99
_LEAST_GAIN = 12.0  # log likelihood; chance gives 5 over a hundred pairs
_PAIRS = 100.0
_MENDS = 1e-3  # what is left of exchanged collects may be as rare as this
_LEAST_RUNS = 4
_LEAST_FREEDOM = 6
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


def find_outliers(
    blocks: Sequence[Block], tables: Sequence[NoiseTable], rich: Sequence[Sequence[FloatArray]]
) -> list[dict[str, Any]]:
    """Return rows that stand out, strongest first: sensor, row index, channel index, score, size in deg/hr.

    Rows are judged beside a rich model of the means, (N, p), so that a missing effect is not taken for a row's fault.
    """
    out = []
    for block, table, extra in zip(blocks, tables, rich, strict=True):
        flexible = block.with_base(extra[0]) if extra else block
        if len(block.y) - flexible.base.shape[1] < 8:
            flexible = block
        if len(block.y) - flexible.base.shape[1] >= _LEAST_FREEDOM:
            out += _of_block(flexible, block, table)
    return sorted(out, key=lambda o: -abs(o["score"]))


def _of_block(block: Block, plain: Block, table: NoiseTable) -> list[dict[str, Any]]:
    """The outlying rows beside a flexible model of the means; `plain` is the block beside its own base.

    Where a flexible model has hardly more rows than values at a setpoint, all of these stand out alike: the row at
    fault is the one that stands out beside the base, too.
    """
    middle = float(np.median(block.y))
    usual = float(np.median(np.abs(block.y - middle)))
    one_value = usual <= _ROUNDING * max(abs(middle), 1.0)  # of most averages, as coarsely rounded: no measure
    gross = np.abs(block.y - middle) > (np.inf if one_value else _GROSS * usual)
    most = max(1, int(_SHARE * len(block.y)))
    kept = ~gross if 0 < gross.sum() <= most else np.ones(len(block.y), dtype=bool)
    found = [_found(block, int(row), np.inf, float(block.y[row] - middle)) for row in np.flatnonzero(~kept)]
    limit = max(float(-ndtri(_LEVEL / 2 / len(block.y))), _LEAST_SCORE)
    for _ in range(most - len(found)):
        rows = np.flatnonzero(kept)
        less = block.take(kept)
        noise = estimate_noise(less, _on(less, table)) if kept.all() else _reduced(less, table)
        score, size = studentised(less, noise)
        alike = np.flatnonzero(np.abs(score) >= max(limit, _ALIKE * float(np.abs(score).max())))
        if not len(alike):
            break
        beside_base, _ = studentised(plain.take(kept), noise)
        worst = int(alike[np.argmax(np.abs(beside_base[alike]))])
        found.append(_found(block, int(rows[worst]), float(score[worst]), float(size[worst])))
        kept[rows[worst]] = False
    return found


def _found(block: Block, row: int, score: float, size: float) -> dict[str, Any]:
    return {
        "sensor": block.sensor,
        "row": int(block.rows[row]),
        "channel": int(block.channel[row]),
        "score": min(score, BEYOND_SCORES),
        "size_deg_per_hr": size,
    }


def _on(block: Block, table: NoiseTable) -> NoiseTable:
    return table if len(block.y) == table.whitening.shape[1] else NoiseTable.on(block, table.grid)


def _reduced(block: Block, table: NoiseTable) -> BlockNoise:
    return estimate_noise(block, NoiseTable.on(block, table.grid))


def studentised(block: Block, noise: BlockNoise) -> tuple[FloatArray, FloatArray]:
    """Return each row's externally studentised residual (N,), as a normal score, and its size in deg/hr."""
    precision = noise.whitening.T @ noise.whitening
    weighted = precision @ block.base
    inner = np.linalg.pinv(block.base.T @ weighted)
    projector = precision - weighted @ inner @ weighted.T
    diagonal = np.clip(np.diagonal(projector), 1e-12, None)
    gradient = projector @ block.y
    size = gradient / diagonal  # the row's departure from its prediction by all others
    squared = gradient**2 / diagonal
    freedom = len(block.y) - block.base.shape[1]
    rss = float(block.y @ gradient)
    seen = diagonal > 1e-3 * np.diagonal(precision)
    scale = np.maximum((rss - squared) / max(freedom - 1, 1), 1e-12)
    t = np.where(seen, gradient / np.sqrt(diagonal) / np.sqrt(scale), 0.0)
    normal = np.sign(t) * -ndtri(np.clip(stdtr(max(freedom - 1, 1), -np.abs(t)), 1e-300, 0.5))
    return normal, size


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
    projectors = [_projector(block, n) for block, n in zip(blocks, noise, strict=True)]
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


def _projector(block: Block, noise: BlockNoise) -> FloatArray:
    """The matrix P with y'Py the weighted sum of squares that the base leaves."""
    base = noise.whitening @ block.base
    q, _ = np.linalg.qr(base)
    maker = noise.whitening - q @ (q.T @ noise.whitening)
    return np.asarray(maker.T @ maker)


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


def left_out(campaign: Campaign, outliers: Sequence[Mapping[str, Any]]) -> Campaign:
    """Return the campaign with the rates of outlying rows empty."""
    sensors = dict(campaign.sensors)
    for number, collects in campaign.sensors.items():
        rates = collects.rates_deg_per_hr.copy()
        for outlier in outliers:
            if outlier["sensor"] == number:
                rates[outlier["row"], outlier["channel"]] = np.nan
        sensors[number] = Collects(collects.conditions, rates, collects.rates_se_deg_per_hr)
    return replace(campaign, sensors=sensors)
