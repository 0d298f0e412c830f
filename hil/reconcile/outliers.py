"""Rows that no model of the unit could explain: glitches, and labels that were exchanged.

Each row, and each collect of all channels together, is judged by its prediction from all other rows under the estimated
noise (externally studentised). What stands out is reported and left out of the search, at most a tenth of the rows. Where
two positions of one run stand out and exchanging their labels mends both, the labels were exchanged: that is a finding
of its own, and it is mended, not left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy import stats

from hil.campaign import Campaign, Collects, FloatArray
from hil.reconcile.blocks import Block
from hil.reconcile.evidence import NoiseTable
from hil.reconcile.fit import BlockNoise, estimate_noise

_SHARE = 0.1
_LEVEL = 0.002  # familywise, of declaring any outlier in clean data
_LEAST_SCORE = 4.5


@dataclass(frozen=True)
class Exchange:
    """Two collects of one run whose labels were exchanged."""

    sensor: int
    run: int
    positions: tuple[str, str]
    gain: float


def find_outliers(
    blocks: Sequence[Block], tables: Sequence[NoiseTable], rich: Sequence[Sequence[FloatArray]]
) -> list[dict[str, Any]]:
    """Return rows that stand out, strongest first: sensor, row index, channel index, score, size in deg/hr.

    Rows are judged beside a rich model of the means, so that a missing effect is not taken for a row's fault.
    """
    out = []
    for block, table, extra in zip(blocks, tables, rich, strict=True):
        flexible = block.with_base(extra[0]) if extra else block
        if len(block.y) - flexible.base.shape[1] < 8:
            flexible = block
        out += _of_block(flexible, table)
    return sorted(out, key=lambda o: -abs(o["score"]))


def _of_block(block: Block, table: NoiseTable) -> list[dict[str, Any]]:
    kept = np.ones(len(block.y), dtype=bool)
    found = []
    limit = max(float(stats.norm.isf(_LEVEL / 2 / len(block.y))), _LEAST_SCORE)
    for _ in range(max(1, int(_SHARE * len(block.y)))):
        rows = np.flatnonzero(kept)
        less = block.take(kept)
        noise = estimate_noise(less, _on(less, table)) if len(found) == 0 else _reduced(less, table)
        score, size = studentised(less, noise)
        worst = int(np.argmax(np.abs(score)))
        if abs(score[worst]) < limit:
            break
        row = rows[worst]
        found.append(
            {
                "sensor": block.sensor,
                "row": int(block.rows[row]),
                "channel": int(block.channel[row]),
                "score": float(score[worst]),
                "size_deg_per_hr": float(size[worst]),
            }
        )
        kept[row] = False
    return found


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
    normal = np.sign(t) * stats.norm.isf(np.clip(stats.t.sf(np.abs(t), max(freedom - 1, 1)), 1e-300, 0.5))
    return normal, size


def exchanges(
    campaign: Campaign, blocks: Sequence[Block], tables: Sequence[NoiseTable], outliers: Sequence[Mapping[str, Any]]
) -> list[Exchange]:
    """Return the pairs of labels in one run that were exchanged: both rates, put in each other's place, fit well."""
    found = []
    suspects = {(o["sensor"], int(campaign.sensors[o["sensor"]].conditions.run[o["row"]])) for o in outliers}
    for sensor, run in sorted(suspects):
        collects = campaign.sensors[sensor]
        rows = np.flatnonzero(collects.conditions.run == run)
        own = [b for b, block in enumerate(blocks) if block.sensor == sensor]
        noise = {b: estimate_noise(blocks[b], tables[b]) for b in own}
        before = sum(_misfit(blocks[b], noise[b], blocks[b].y) for b in own)
        best: tuple[float, Exchange] | None = None
        for i, j in combinations(rows.tolist(), 2):
            after = sum(_misfit(blocks[b], noise[b], _exchanged(blocks[b], i, j, collects)) for b in own)
            pair = (str(collects.conditions.position[i]), str(collects.conditions.position[j]))
            if pair[0] != pair[1] and (best is None or before - after > best[0]):
                best = (before - after, Exchange(sensor, run, pair, before - after))
        needed = 30.0
        if best is not None and best[0] > needed:
            found.append(best[1])
    return found


def _misfit(block: Block, noise: BlockNoise, y: FloatArray) -> float:
    white = noise.whitening @ y
    base = noise.whitening @ block.base
    q, _ = np.linalg.qr(base)
    rest = white - q @ (q.T @ white)
    return float(rest @ rest)


def _exchanged(block: Block, i: int, j: int, collects: Collects) -> FloatArray:
    """The block's rates with those of collects i and j in each other's place (earth rate taken off where it belongs)."""
    y = block.y.copy()
    w = collects.conditions.w_channels_deg_per_hr
    for channel in np.unique(block.channel):
        a = np.flatnonzero((block.rows == i) & (block.channel == channel))
        b = np.flatnonzero((block.rows == j) & (block.channel == channel))
        if len(a) and len(b):
            step = w[i, channel] - w[j, channel]
            y[a], y[b] = block.y[b] - step, block.y[a] + step
    return y


def mended(campaign: Campaign, found: Sequence[Exchange]) -> Campaign:
    """Return the campaign with exchanged rates put back in their places."""
    sensors = dict(campaign.sensors)
    for exchange in found:
        collects = sensors[exchange.sensor]
        conditions = collects.conditions
        rows = [
            int(np.flatnonzero((conditions.run == exchange.run) & (conditions.position == label))[0])
            for label in exchange.positions
        ]
        rates, errors = collects.rates_deg_per_hr.copy(), collects.rates_se_deg_per_hr.copy()
        rates[rows], errors[rows] = rates[rows[::-1]], errors[rows[::-1]]
        sensors[exchange.sensor] = Collects(conditions, rates, errors)
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
